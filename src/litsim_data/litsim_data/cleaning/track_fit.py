"""Fit of one vehicle's noisy positions by a kinematic model: a smooth path of the rear axle and a smooth time law.

The rear axle follows a curve A(s), the vehicle points along the curve (no slip), and the tracked point, such as the
front centre, is ``reach`` ahead, at A(s) + reach A'(s). That is linear in A, so the curve is a smoothing spline
observed through this operator; measured headings observe A'(s). The time law s(t) along the curve is a smoothing spline
that never decreases and is constant in stops. Yaw, speed, acceleration and yaw rate are derivatives of the two: they
agree with the positions by construction, and while s is constant the vehicle is at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from litsim_data.cleaning.splines import Knots, fit, huber_weight, solve
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import RATE_HZ, STEP_S, BoolArray, FloatArray

ROUNDS = 3  # rounds of fitting time law, path and places along it; places change by millimetres in the last
LAW_ROUNDS = 25  # rounds of reweighting and of finding where the time law would decrease
ROUGH_PERIOD_S = 2.0  # [s] period of the first smoothing, which only finds directions
CHORD = 4.0  # [m] half length of the chords that give the first directions
CREEP = 0.5  # [m/s] slower travel does not count in those
KNOT = 1.0  # [m] spacing of the path's knots
MARGIN = 1.0  # [m] length of path beyond both ends
STIFF = 1e6  # weight that makes a speed zero, relative to that of a position
LEAST_WEIGHT = 0.1  # smallest weight of a sample in the path fit
CURVATURE = 0.05  # [1/m] prior standard deviation of curvature
CURVATURE_LENGTH = 10.0  # [m] correlation length of curvature
NOISE = 0.15  # [m] standard deviation of raw positions
HINT_SLOPE = 0.1  # [rad] standard deviation of hints of the direction
HEADING_NOISE = 0.05  # [rad] standard deviation of measured headings
REVERSED = 1.0  # [m] travel against its headings from which on a vehicle has driven backwards
PATH_SPEED = 3.0  # [m/s] speed below which a path is smoothed over length instead of time: slow vehicles do not wriggle
HUBER = 0.3  # [m] residuals beyond this are outliers that count linearly
STOP_SPEED, STOP_S, STOP_TRAVEL = 0.25, 0.5, 0.4  # [m/s], [s], [m]: stops are slower, as long, and cover less
ACCELERATION = 3.0  # [m/s2] usual magnitude; regularises short tracks and the ends of tracks
REAR_AXLE = VehicleLimits.rear_axle  # distance of the rear axle, which does not slip, behind the box centre [lengths]


@dataclass(frozen=True)
class CleaningConfig:
    """Cutoff periods between noise and motion; longer ones give calmer accelerations.

    Attributes:
        longitudinal_period_s: cutoff period T0 [s] along the road: oscillations of period T are scaled by
            1 / (1 + (T0 / T)^6).
        lateral_period_s: the same across the road.
    """

    longitudinal_period_s: float = 3.0
    lateral_period_s: float = 3.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"cleaning: {name} is {value}, expected a positive number")


@dataclass(frozen=True)
class Motion:
    """The fitted motion of one vehicle at its n frames, in frame map.

    Attributes:
        axle: (n, 2) positions of the rear axle [m].
        yaw: (n,) direction of its motion [rad], continuous, not wrapped.
        speed, acceleration: (n,) along the yaw [m/s], [m/s2].
    """

    axle: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True)
class TimeLaw:
    """Travel s(t) of one vehicle over `frames` frames: a spline over seconds with a knot at every frame."""

    knots: Knots
    coefficients: FloatArray
    frames: int

    def at_frames(self, derivative: int = 0) -> FloatArray:
        """Returns the `derivative`-th derivative of the travel at every frame (frames,) [m], [m/s] or [m/s2]."""
        return self.knots.evaluate(self.coefficients, _times(self.frames), derivative)


@dataclass(frozen=True)
class Path:
    """The rear axle's curve A(s): a spline parametrised by its length [m], within about a thousandth."""

    knots: Knots
    coefficients: FloatArray

    def at(self, places: FloatArray, derivative: int = 0) -> FloatArray:
        """Returns points [m], or their `derivative`-th derivatives by the travel, (n, 2), at travels `places` (n,)
        [m].
        """
        return self.knots.evaluate(self.coefficients, places, derivative)


def fit_track(
    points: FloatArray, reach: float, config: CleaningConfig, hint: float | None = None, yaw: FloatArray | None = None
) -> Motion:
    """Estimates the motion of one vehicle.

    Args:
        points: (n, 2) raw positions of consecutive frames, n at least 1 [m].
        reach: distance of the tracked point ahead of the rear axle [m].
        config: cutoff periods.
        hint: direction [rad] for a track that leads nowhere; 0 if needed and missing.
        yaw: (n,) measured headings [rad], if there are any.
    """
    towards = None if hint is None else np.array([np.cos(hint), np.sin(hint)])
    headings = None if yaw is None else np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    places = None if headings is None else _places_by_headings(points, headings, reach)
    if places is None or places[-1] < -REVERSED:  # a reversing vehicle is given the direction of its motion
        headings = None
        places = _first_places(points, np.array([1.0, 0.0]) if towards is None else towards)
    path = None
    for _ in range(ROUNDS):
        law = fit_law(places, config.longitudinal_period_s)
        path = fit_path(points, places, law, reach, config.lateral_period_s, towards, headings, path)
        places = _project(points, places, path, reach)
    law = fit_law(places, config.longitudinal_period_s)
    path = fit_path(points, places, law, reach, config.lateral_period_s, towards, headings, path)
    travel, rate, change = (law.at_frames(derivative) for derivative in range(3))
    rate = np.maximum(rate, 0.0)  # rounding
    tangent, bend = path.at(travel, 1), path.at(travel, 2)
    stretch = np.linalg.norm(tangent, axis=1)
    tangential = (tangent * bend).sum(axis=1) / stretch
    return Motion(
        axle=path.at(travel),
        yaw=np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])),
        speed=rate * stretch,
        acceleration=change * stretch + rate**2 * tangential,
    )


def fit_law(places: FloatArray, period: float) -> TimeLaw:
    """Fits the time law to noisy `places` (n,) [m] along the path, one per frame, with the cutoff `period` [s].

    It never decreases, and is constant in stops.
    """
    count = len(places)
    knots = Knots(0.0, STEP_S, max(count - 1, 1))
    if count == 1:
        return TimeLaw(knots, np.full(knots.size, places[0]), count)
    guess = 4.0 * NOISE**2 / (2.0 * ACCELERATION**2)  # correlation times: noise 0.5 s, accelerations 2 s
    smooth = knots.penalty(3, _jerk_weight(period)) + knots.penalty(2, guess)
    basis = knots.basis(_times(count))
    held = np.zeros(knots.size - 1, np.bool_)
    coefficients = _rising(knots, basis, places, smooth, held)
    held = _stops(knots, coefficients, count)
    if held.any():
        coefficients = _rising(knots, basis, places, smooth, held)
    steps = np.maximum(np.diff(coefficients), 0.0)
    steps[held] = 0.0
    exact = np.concatenate([[0.0], np.cumsum(steps)])  # removes what the stiff weight leaves of speeds in stops
    return TimeLaw(knots, exact + (coefficients - exact).mean(), count)


def fit_path(
    points: FloatArray,
    places: FloatArray,
    law: TimeLaw,
    reach: float,
    period: float,
    hint: FloatArray | None,
    headings: FloatArray | None,
    previous: Path | None,
) -> Path:
    """Fits the rear axle's curve for which the points `reach` [m] ahead of `places` (n,) are at `points` (n, 2).

    The penalty is on lateral jerk: the change of curvature times the cubed speed; below PATH_SPEED on the change of
    curvature itself. A curve's third derivative has the change of curvature as its normal component and minus
    the squared curvature as its tangential one; the latter is taken from the `previous` round, so that only changes of
    curvature are penalised.

    Args:
        points, places, law, reach: as above.
        period: cutoff period of lateral motion [s].
        hint: (2,) weak prior of the direction, or None.
        headings: (n, 2) measured directions, or None.
        previous: path of the previous round, or None.
    """
    low, high = float(places.min()) - MARGIN, float(places.max()) + MARGIN
    knots = Knots(low, KNOT, max(1, int(np.ceil((high - low) / KNOT - 1e-9))))
    speed, travel = law.at_frames(1), law.at_frames()
    middles = knots.places()[:-1] + 0.5 * KNOT
    pace = np.maximum(np.interp(middles, travel, speed), PATH_SPEED)
    jerk_weight = _jerk_weight(period) * pace**5
    penalty = knots.penalty(3, jerk_weight)
    penalty += knots.penalty(2, 4.0 * NOISE**2 / (CURVATURE**2 * CURVATURE_LENGTH))
    first, point = knots.basis(places)
    rows = point + reach * knots.basis(places, 1)[1]
    weight = np.clip(speed / PATH_SPEED, LEAST_WEIGHT, 1.0)
    values = points
    if headings is not None:
        knot, slope = knots.basis(places, 1)
        first, rows = np.concatenate([first, knot]), np.concatenate([rows, slope])
        moving = np.clip(speed / PATH_SPEED, 0.0, 1.0)  # many sources give no headings at standstill
        weight = np.concatenate([weight, moving * (NOISE / HEADING_NOISE) ** 2])
        values = np.concatenate([values, headings])
    if hint is not None:
        knot, slope = knots.basis(middles, 1)
        first, rows = np.concatenate([first, knot]), np.concatenate([rows, slope])
        strength = 4.0 * NOISE**2 / (HINT_SLOPE**2 * len(middles))
        weight = np.concatenate([weight, np.full(len(middles), strength)])
        values = np.concatenate([values, np.broadcast_to(hint, (len(middles), 2))])
    pull = 0.0 if previous is None else knots.pull(3, jerk_weight, _bending(previous, middles))
    return Path(knots, fit(knots, (first, rows), values, weight, penalty, HUBER, pull))


def _bending(path: Path, places: FloatArray) -> FloatArray:
    """Returns the third derivative (n, 2) at `places` (n,) of a curve of constant curvature, that of `path` there."""
    tangent, bend = path.at(places, 1), path.at(places, 2)
    across = tangent[:, 0] * bend[:, 1] - tangent[:, 1] * bend[:, 0]
    return cast(FloatArray, -((across / (tangent**2).sum(axis=1)) ** 2)[:, None] * tangent)


def _times(frames: int) -> FloatArray:
    """Returns the time (frames,) [s] of every frame since the first one."""
    return STEP_S * np.arange(frames, dtype=np.float64)


def _jerk_weight(period: float) -> float:
    """Returns the weight of the squared jerk, relative to positions at 10 Hz, to halve oscillations of `period` [s]."""
    return RATE_HZ * (period / (2.0 * np.pi)) ** 6


def _rising(
    knots: Knots,
    basis: tuple[np.ndarray, FloatArray],
    places: FloatArray,
    smooth: FloatArray,
    held: BoolArray,
) -> FloatArray:
    """Fits a robust smoothing spline (size,) that never decreases and is constant where `held` (size - 1,).

    Coefficients that do not decrease are sufficient; a stiff penalty where they would makes them so (Eilers, "Unimodal
    smoothing", Journal of Chemometrics 19, 2005).
    """
    first, rows = basis
    robust, level = np.ones(len(places)), held
    for _ in range(LAW_ROUNDS):
        bands = knots.gram(first, rows, robust) + smooth
        if level.any():
            bands += knots.penalty(1, STIFF * level.astype(np.float64))
        coefficients = solve(bands, knots.project(first, rows, (robust * places)[:, None]))[:, 0]
        fitted = (rows * coefficients[first[:, None] + np.arange(4)]).sum(axis=1)
        renewed, falling = huber_weight((places - fitted)[:, None], HUBER), held | (np.diff(coefficients) < 0.0)
        settled = bool(np.abs(renewed - robust).max() < 0.01) and bool((falling == level).all())
        robust, level = renewed, falling
        if settled:
            break
    return coefficients


def _stops(knots: Knots, coefficients: FloatArray, count: int) -> BoolArray:
    """Returns the mask (size - 1,) of coefficients that must equal the next because the vehicle is at rest."""
    times = _times(count)
    travel, speed = (knots.evaluate(coefficients, times, derivative) for derivative in (0, 1))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], speed < STOP_SPEED, [False]])))
    held = np.zeros(knots.size - 1, np.bool_)
    for begin, end in edges.reshape(-1, 2):
        lasts = (end - begin) * STEP_S >= STOP_S or end - begin == count
        if lasts and travel[end - 1] - travel[begin] < STOP_TRAVEL:
            held[begin : end + 1] = True
    return held


def _first_places(points: FloatArray, fallback: FloatArray) -> FloatArray:
    """Returns initial places (n,) [m] along the path: raw steps projected on smoothed directions.

    Steps are signed, so noise does not add up to travel; the directions are those of chords of a few metres.
    """
    count = len(points)
    if count == 1:
        return np.zeros(1)
    rough, velocity = _roughly_smooth(points)
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


def _places_by_headings(points: FloatArray, headings: FloatArray, reach: float) -> FloatArray:
    """Returns initial places (n,) [m] along the path: steps of the rear axle, located by the headings (n, 2)."""
    if len(points) == 1:
        return np.zeros(1)
    direction = _roughly_smooth(headings)[0]
    direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-3)
    return _travelled(points - reach * direction, direction)


def _roughly_smooth(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns robustly smoothed `values` (n, 2) of consecutive frames, n above 1, and their derivative (n, 2) [1/s]."""
    count = len(values)
    knots = Knots(0.0, STEP_S, count - 1)
    times = _times(count)
    penalty = knots.penalty(3, _jerk_weight(ROUGH_PERIOD_S)) + knots.penalty(2, 1e-3)
    coefficients = fit(knots, knots.basis(times), values, np.ones(count), penalty, HUBER)
    return knots.evaluate(coefficients, times), knots.evaluate(coefficients, times, 1)


def _travelled(points: FloatArray, direction: FloatArray) -> FloatArray:
    """Returns the distance travelled (n,): steps between `points` (n, 2), projected on the `direction` (n, 2) there."""
    steps = np.diff(points, axis=0) * 0.5 * (direction[1:] + direction[:-1])
    return np.concatenate([[0.0], np.cumsum(steps.sum(axis=1))])


def _project(points: FloatArray, places: FloatArray, path: Path, reach: float) -> FloatArray:
    """Returns arc lengths (n,) at which the path is closest to the points (n, 2), by one Newton step from `places`."""
    tangent = path.at(places, 1)
    beyond = points - path.at(places) - reach * tangent
    closest = places + (beyond * tangent).sum(axis=1) / (tangent**2).sum(axis=1)
    grid = np.linspace(path.knots.origin, path.knots.places()[-1], 4 * path.knots.pieces + 1)
    stretch = np.linalg.norm(path.at(grid, 1), axis=1)
    length = np.concatenate([[0.0], np.cumsum(0.5 * (stretch[1:] + stretch[:-1]) * np.diff(grid))])
    return cast(FloatArray, np.interp(closest, grid, length))
