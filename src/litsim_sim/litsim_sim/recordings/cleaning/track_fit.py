"""One vehicle's noisy positions explained as a vehicle: a smooth path of the rear axle and a smooth time law.

The rear axle follows a curve A(s), the vehicle points along the curve (no slip), and the point that was tracked, such
as the front centre, is a ``reach`` ahead, at A(s) + reach A'(s). That is linear in A, so the curve is a smoothing
spline seen through this operator; headings, where they were measured, are seen as A'(s). A time law s(t), a smoothing
spline that never falls and is constant in stops, drives along the curve. Yaw, speed, acceleration and yaw rate are
derivatives of the two: they agree with the positions by construction, and where s stands still everything stands still.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import RATE_HZ, STEP_S, BoolArray, FloatArray
from litsim_sim.recordings.cleaning.splines import Knots, fit, huber_weight, solve

ROUNDS = 3  # of time law, path, and the front centres' places along it: places change by millimetres in the last
LAW_ROUNDS = 25  # of reweighting and of finding where the time law would fall
ROUGH_PERIOD_S = 2.0  # [s] of the first smoothing, which only finds directions
CHORD = 4.0  # [m] half length of the chords that give the first directions
CREEP = 0.5  # [m/s] slower travel does not count in those
KNOT = 1.0  # [m] between the path's knots
MARGIN = 1.0  # [m] of path beyond both ends
STIFF = 1e6  # weight that makes a speed zero, relative to a position's
LEAST_WEIGHT = 0.1  # of a sample in the path fit, however slow
CURVATURE = 0.05  # [1/m] usual; what is not measured well bends less than this
CURVATURE_LENGTH = 10.0  # [m] after which curvatures are unrelated
NOISE = 0.15  # [m] of raw positions, for what is weighed against them
HINT_SLOPE = 0.1  # [rad] by which hints of the direction are off
HEADING_NOISE = 0.05  # [rad] of measured headings, for what is weighed against them
REVERSED = 1.0  # [m] against its headings, from which on a vehicle has driven backwards


@dataclass(frozen=True)
class CleaningConfig:
    """What is noise and what is motion.

    Attributes:
        longitudinal_period_s: oscillations along the road of this period are halved, shorter ones vanish, longer ones
            stay (third-order, as 1 / (1 + (period / T)^6)). Longer for calmer accelerations.
        lateral_period_s: the same across the road, for vehicles faster than `path_speed`.
        path_speed: below this speed [m/s] the path is smoothed over the length that it covers in the lateral period, so
            that slow vehicles do not wriggle.
        huber: residuals beyond this [m] are outliers that count linearly.
        stop_speed: slower stretches [m/s] are stops, if they last `stop_s` [s] and lead less than `stop_travel` [m].
        acceleration: usual size [m/s2]; holds the ends of tracks and short tracks back from guessing more.
        rear_axle: distance of the rear axle, which does not slip, behind the box centre, as a share of the length.
    """

    longitudinal_period_s: float = 3.0
    lateral_period_s: float = 3.0
    path_speed: float = 3.0
    huber: float = 0.3
    stop_speed: float = 0.25
    stop_s: float = 0.5
    stop_travel: float = 0.4
    acceleration: float = 3.0
    rear_axle: float = VehicleLimits.rear_axle

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and (value > 0 or (name == "rear_axle" and value >= -0.5))):
                raise InputError(f"cleaning: {name} is {value}, expected a positive number")


@dataclass(frozen=True)
class Motion:
    """The fitted motion of one vehicle at its frames; arrays (n,) but for the positions (n, 2), in frame map.

    Attributes:
        axle: rear axle [m].
        yaw: direction of its motion [rad], continuous, not wrapped.
        speed, acceleration: along the yaw [m/s], [m/s2].
        yaw_rate: [rad/s].
        travel: length of the path [m].
    """

    axle: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    yaw_rate: FloatArray
    travel: float


@dataclass(frozen=True)
class TimeLaw:
    """Travel s(t) of one vehicle over `frames` frames: a spline over seconds with a knot at every frame."""

    knots: Knots
    coefficients: FloatArray
    frames: int

    def at_frames(self, derivative: int = 0) -> FloatArray:
        """The `derivative`-th derivative of the travel at every frame (frames,) [m, m/s, m/s2]."""
        return self.knots.evaluate(self.coefficients, _times(self.frames), derivative)


@dataclass(frozen=True)
class Path:
    """The rear axle's curve A(s): a spline over metres, whose parameter is its length within about a thousandth."""

    knots: Knots
    coefficients: FloatArray

    def at(self, places: FloatArray, derivative: int = 0) -> FloatArray:
        """Point [m], or its `derivative`-th derivative by the travel, (n, 2), at the travels `places` (n,) [m]."""
        return self.knots.evaluate(self.coefficients, places, derivative)


def fit_track(
    points: FloatArray, reach: float, config: CleaningConfig, hint: float | None = None, yaw: FloatArray | None = None
) -> Motion:
    """Estimate the motion of one vehicle.

    Args:
        points: (n, 2) raw positions of consecutive frames, n at least 1 [m].
        reach: by how much they are ahead of the rear axle [m].
        config: what is noise.
        hint: direction [rad] for a track that leads nowhere; the x axis if it is needed and missing.
        yaw: (n,) measured headings [rad], if there are any.
    """
    towards = None if hint is None else np.array([np.cos(hint), np.sin(hint)])
    headings = None if yaw is None else np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    places = None if headings is None else _places_by_headings(points, headings, reach, config)
    if places is None or places[-1] < -REVERSED:  # who drives backwards is taken to point where it goes
        headings = None
        places = _first_places(points, config, np.array([1.0, 0.0]) if towards is None else towards)
    path = None
    for _ in range(ROUNDS):
        law = fit_law(places, config)
        path = fit_path(points, places, law, reach, config, towards, headings, path)
        places = _project(points, places, path, reach)
    law = fit_law(places, config)
    path = fit_path(points, places, law, reach, config, towards, headings, path)
    travel, rate, change = (law.at_frames(derivative) for derivative in range(3))
    rate = np.maximum(rate, 0.0)  # rounding
    tangent, bend = path.at(travel, 1), path.at(travel, 2)
    stretch = np.linalg.norm(tangent, axis=1)
    tangential = (tangent * bend).sum(axis=1) / stretch
    across = tangent[:, 0] * bend[:, 1] - tangent[:, 1] * bend[:, 0]
    return Motion(
        axle=path.at(travel),
        yaw=np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])),
        speed=rate * stretch,
        acceleration=change * stretch + rate**2 * tangential,
        yaw_rate=rate * across / stretch**2,
        travel=float(travel[-1] - travel[0]),
    )


def fit_law(places: FloatArray, config: CleaningConfig) -> TimeLaw:
    """The time law through noisy `places` (n,) [m] along the path, one per frame: never falling, constant in stops."""
    count = len(places)
    knots = Knots(0.0, STEP_S, max(count - 1, 1))
    if count == 1:
        return TimeLaw(knots, np.full(knots.size, places[0]), count)
    guess = 4.0 * NOISE**2 / (2.0 * config.acceleration**2)  # noise and accelerations last: half a second, two seconds
    smooth = knots.penalty(3, _jerk_weight(config.longitudinal_period_s)) + knots.penalty(2, guess)
    basis = knots.basis(_times(count))
    held = np.zeros(knots.size - 1, np.bool_)
    coefficients = _rising(knots, basis, places, smooth, config.huber, held)
    held = _stops(knots, coefficients, count, config)
    if held.any():
        coefficients = _rising(knots, basis, places, smooth, config.huber, held)
    steps = np.maximum(np.diff(coefficients), 0.0)
    steps[held] = 0.0
    exact = np.concatenate([[0.0], np.cumsum(steps)])  # differs by what the stiff weight left over
    return TimeLaw(knots, exact + (coefficients - exact).mean(), count)


def fit_path(
    points: FloatArray,
    places: FloatArray,
    law: TimeLaw,
    reach: float,
    config: CleaningConfig,
    hint: FloatArray | None,
    headings: FloatArray | None,
    previous: Path | None,
) -> Path:
    """The rear axle's curve that puts what is `reach` ahead of `places` (n,) to `points` (n, 2).

    Smoothness is that of the lateral motion in time: change of curvature times the cubed speed is the lateral jerk.
    Below `config.path_speed` it is smoothness in space. A curve's third derivative is its change of curvature across it
    and minus the squared curvature along it; the latter part is taken from the `previous` round, so that bends cost
    nothing, only changes of them do.

    Args:
        hint: (2,) direction to keep to unless the positions say otherwise.
        headings: (n, 2) measured directions, or None.
        previous: path of the round before, if there is one.
    """
    knots = Knots.covering(float(places.min()) - MARGIN, float(places.max()) + MARGIN, KNOT)
    speed, travel = law.at_frames(1), law.at_frames()
    middles = knots.places()[:-1] + 0.5 * KNOT
    pace = np.maximum(np.interp(middles, travel, speed), config.path_speed)
    jerk_weight = _jerk_weight(config.lateral_period_s) * pace**5
    penalty = knots.penalty(3, jerk_weight)
    penalty += knots.penalty(2, 4.0 * NOISE**2 / (CURVATURE**2 * CURVATURE_LENGTH))
    first, point = knots.basis(places)
    rows = point + reach * knots.basis(places, 1)[1]
    weight = np.clip(speed / config.path_speed, LEAST_WEIGHT, 1.0)
    values = points
    if headings is not None:
        at, slope = knots.basis(places, 1)
        first, rows = np.concatenate([first, at]), np.concatenate([rows, slope])
        moving = np.clip(speed / config.path_speed, 0.0, 1.0)  # many sources keep no heading of who stands
        weight = np.concatenate([weight, moving * (NOISE / HEADING_NOISE) ** 2])
        values = np.concatenate([values, headings])
    if hint is not None:
        at, slope = knots.basis(middles, 1)
        first, rows = np.concatenate([first, at]), np.concatenate([rows, slope])
        strength = 4.0 * NOISE**2 / (HINT_SLOPE**2 * len(middles))
        weight = np.concatenate([weight, np.full(len(middles), strength)])
        values = np.concatenate([values, np.broadcast_to(hint, (len(middles), 2))])
    pull = 0.0 if previous is None else knots.pull(3, jerk_weight, _bending(previous, middles))
    return Path(knots, fit(knots, (first, rows), values, weight, penalty, config.huber, pull))


def _bending(path: Path, places: FloatArray) -> FloatArray:
    """The third derivative (n, 2) of a curve of `path`'s curvature that does not change, at `places` (n,)."""
    tangent, bend = path.at(places, 1), path.at(places, 2)
    across = tangent[:, 0] * bend[:, 1] - tangent[:, 1] * bend[:, 0]
    return cast(FloatArray, -((across / (tangent**2).sum(axis=1)) ** 2)[:, None] * tangent)


def _times(frames: int) -> FloatArray:
    """Time (frames,) [s] of every frame since the first one."""
    return STEP_S * np.arange(frames, dtype=np.float64)


def _jerk_weight(period: float) -> float:
    """Weight of the squared jerk, beside positions at 10 Hz, that halves oscillations of `period` [s]."""
    return RATE_HZ * (period / (2.0 * np.pi)) ** 6


def _rising(
    knots: Knots,
    basis: tuple[np.ndarray, FloatArray],
    places: FloatArray,
    smooth: FloatArray,
    limit: float,
    held: BoolArray,
) -> FloatArray:
    """Coefficients (size,) of a robust smoothing spline that rise, and are level where `held` (size - 1,).

    A spline with rising coefficients rises. They are made to by a stiff penalty where they fell (Eilers,
    "Unimodal smoothing", Journal of Chemometrics 19, 2005).
    """
    first, rows = basis
    robust, level = np.ones(len(places)), held
    for _ in range(LAW_ROUNDS):
        bands = knots.gram(first, rows, robust) + smooth
        if level.any():
            bands += knots.penalty(1, STIFF * level.astype(np.float64))
        coefficients = solve(bands, knots.project(first, rows, (robust * places)[:, None]))[:, 0]
        seen = (rows * coefficients[first[:, None] + np.arange(4)]).sum(axis=1)
        renewed, falling = huber_weight((places - seen)[:, None], limit), held | (np.diff(coefficients) < 0.0)
        settled = bool(np.abs(renewed - robust).max() < 0.01) and bool((falling == level).all())
        robust, level = renewed, falling
        if settled:
            break
    return coefficients


def _stops(knots: Knots, coefficients: FloatArray, count: int, config: CleaningConfig) -> BoolArray:
    """Which coefficients (size - 1,) must not differ from the next because the vehicle stands."""
    times = _times(count)
    travel, speed = (knots.evaluate(coefficients, times, derivative) for derivative in (0, 1))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], speed < config.stop_speed, [False]])))
    held = np.zeros(knots.size - 1, np.bool_)
    for begin, end in edges.reshape(-1, 2):
        lasts = (end - begin) * STEP_S >= config.stop_s or end - begin == count
        if lasts and travel[end - 1] - travel[begin] < config.stop_travel:
            held[begin : end + 1] = True
    return held


def _first_places(points: FloatArray, config: CleaningConfig, fallback: FloatArray) -> FloatArray:
    """First guess of the places (n,) along the path: steps between raw positions, seen along smoothed directions.

    Steps are signed, so noise does not add up to travel; the directions are those of chords of a few metres.
    """
    count = len(points)
    if count == 1:
        return np.zeros(1)
    rough, velocity = _roughly_smooth(points, config)
    travel = np.cumsum(np.maximum(np.linalg.norm(velocity, axis=1) - CREEP, 0.0)) * STEP_S
    chord = np.stack(
        [
            np.interp(travel + CHORD, travel, rough[:, axis]) - np.interp(travel - CHORD, travel, rough[:, axis])
            for axis in range(2)
        ],
        axis=1,
    )
    size = np.linalg.norm(chord, axis=1, keepdims=True)
    whole = rough[-1] - rough[0]
    if np.linalg.norm(whole) > 1.0:
        fallback = whole / np.linalg.norm(whole)
    direction = np.where(size > 1.0, chord / np.maximum(size, 1.0), fallback)
    return _travelled(points, direction)


def _places_by_headings(points: FloatArray, headings: FloatArray, reach: float, config: CleaningConfig) -> FloatArray:
    """First guess of the places (n,) along the path: steps of the rear axle, as headings (n, 2) tell where it is."""
    if len(points) == 1:
        return np.zeros(1)
    direction = _roughly_smooth(headings, config)[0]
    direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-3)
    return _travelled(points - reach * direction, direction)


def _roughly_smooth(values: FloatArray, config: CleaningConfig) -> tuple[FloatArray, FloatArray]:
    """Robustly smoothed `values` (n, 2) of consecutive frames, n above 1, and how they change [1/s]."""
    count = len(values)
    knots = Knots(0.0, STEP_S, count - 1)
    times = _times(count)
    penalty = knots.penalty(3, _jerk_weight(ROUGH_PERIOD_S)) + knots.penalty(2, 1e-3)
    coefficients = fit(knots, knots.basis(times), values, np.ones(count), penalty, config.huber)
    return knots.evaluate(coefficients, times), knots.evaluate(coefficients, times, 1)


def _travelled(points: FloatArray, direction: FloatArray) -> FloatArray:
    """Way (n,) along steps between `points` (n, 2), each seen along the `direction` (n, 2) there."""
    steps = np.diff(points, axis=0) * 0.5 * (direction[1:] + direction[:-1])
    return np.concatenate([[0.0], np.cumsum(steps.sum(axis=1))])


def _project(points: FloatArray, places: FloatArray, path: Path, reach: float) -> FloatArray:
    """Lengths of the path (n,) to where it is closest to the points (n, 2): one Newton step from `places`."""
    tangent = path.at(places, 1)
    beyond = points - path.at(places) - reach * tangent
    closest = places + (beyond * tangent).sum(axis=1) / (tangent**2).sum(axis=1)
    grid = np.linspace(path.knots.origin, path.knots.places()[-1], 4 * path.knots.pieces + 1)
    stretch = np.linalg.norm(path.at(grid, 1), axis=1)
    length = np.concatenate([[0.0], np.cumsum(0.5 * (stretch[1:] + stretch[:-1]) * np.diff(grid))])
    return cast(FloatArray, np.interp(closest, grid, length))
