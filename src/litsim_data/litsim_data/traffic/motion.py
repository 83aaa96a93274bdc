"""From SUMO's jerky points to plausible vehicle motion: smooth paths, smooth progress, and headings along the path.

A vehicle's box centre keeps to a smooth curve and its heading is the curve's tangent; speeds and accelerations are
differences of the way along it. So nothing turns or slides at standstill, and positions, headings, speeds and
accelerations agree by construction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, FloatArray

TIME_FILTER_S = 0.4  # [s] standard deviation of the filter along the road: SUMO's accelerations jump
PATH_STEP = 0.25  # [m] distance of the points of a path
TURN_FILTER = 2.0  # [m] standard deviation where the road turns: a longer filter would cut the corner
TURN_NEAR, TURN_FAR = 8.0, 20.0  # [m] before and after a place between which the directions of the road are compared
TURN = 0.5  # [rad] smallest difference of these where the road turns; a lane change gives less
OFFSET_MAX = 2.0  # [standard deviations] largest offset of a driver from the lane's centre
WANDER_LENGTH = (80.0, 200.0)  # [m] range of wavelengths of a driver's wandering about that
STANDING = 1e-3  # [m] per step, below which a vehicle stands
UNSTEADY_S = 1.0  # [s] standard deviation of the filter that makes a driver's unsteady pedal out of white noise
UNSTEADY_MAX = 2.0  # [standard deviations] largest deviation from a steady driver, ahead or behind
UNSTEADY_SPEED = 8.0  # [m/s] speed below which a driver becomes steadier, down to steady at standstill
TAIL = 1.0  # [m] by which a path continues beyond the box


@dataclass(frozen=True)
class Smoothness:
    """How a path is smoothed and how its driver keeps the lane; lengths in metres.

    Attributes:
        path_filter: standard deviation of the filter along the path: SUMO changes lanes at constant lateral speed,
            which gives an angle to vehicles that creep.
        offset: the driver's mean distance to the left of the lane's centre.
        wander, wander_length, wander_phase: amplitude, wavelength and phase [rad] of the driver's wandering about that.
        unsteadiness: standard deviation of the driver's way ahead of or behind a steady one.
        seed: seed of that deviation.
    """

    path_filter: float
    offset: float = 0.0
    wander: float = 0.0
    wander_length: float = 100.0
    wander_phase: float = 0.0
    unsteadiness: float = 0.0
    seed: int = 0

    def for_driver(self, rng: np.random.Generator) -> Smoothness:
        """Returns one driver of this kind: `offset` is the standard deviation over drivers here."""
        return replace(
            self,
            offset=float(np.clip(rng.normal(0.0, self.offset), -OFFSET_MAX * self.offset, OFFSET_MAX * self.offset)),
            wander_length=float(rng.uniform(*WANDER_LENGTH)),
            wander_phase=float(rng.uniform(0.0, 2.0 * np.pi)),
            seed=int(rng.integers(2**31)),
        )


@dataclass(frozen=True)
class Motion:
    """Motion of a box centre over k steps; each array is (k,): [m], [m], [rad], [m/s], [m/s2]."""

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray


def smooth_motion(front: FloatArray, sumo_speed: FloatArray, length: float, smoothness: Smoothness) -> Motion | None:
    """Returns the motion of a vehicle of `length` [m]; None if it hardly moved.

    Args:
        front: (k, 2) where SUMO had its front centre at successive steps [m].
        sumo_speed: (k,) its speed along the lane [m/s].
        length: length of the vehicle [m].
        smoothness: smoothness of path and driver.
    """
    # The way along the lane: SUMO changes lanes sideways even at standstill, and as a function of this way such a step
    # becomes a part of the path that the filter stretches.
    moved = np.where(sumo_speed[1:] * STEP_S > STANDING, sumo_speed[1:] * STEP_S, 0.0)
    odometer = np.concatenate([[0.0], np.cumsum(moved)])
    if len(front) < 3 or odometer[-1] < 2.0 * PATH_STEP:
        return None
    moves = np.concatenate([[True], moved > 0.0])
    grid, x, y = _path(odometer[moves], front[moves], length, smoothness)
    centre = smooth(odometer, TIME_FILTER_S / STEP_S)
    centre = np.maximum.accumulate(centre + _unsteady(np.gradient(centre, STEP_S), smoothness)) - 0.5 * length
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    travelled = np.interp(centre, grid, way)
    speed = np.maximum(np.gradient(travelled, STEP_S), 0.0)
    # Positions follow from speeds by the trapezoidal rule, so that no step is longer than the speeds at its ends allow.
    travelled = travelled[0] + np.concatenate([[0.0], np.cumsum(0.5 * STEP_S * (speed[1:] + speed[:-1]))])
    heading = np.unwrap(np.arctan2(np.gradient(y, PATH_STEP), np.gradient(x, PATH_STEP)))
    return Motion(
        np.interp(travelled, way, x),
        np.interp(travelled, way, y),
        wrap_angle(np.interp(travelled, way, heading)),
        speed,
        np.gradient(speed, STEP_S),
    )


def _path(
    odometer: FloatArray, front: FloatArray, length: float, smoothness: Smoothness
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns where the path is at the odometer's values `grid` (m,) [m]: grid, x and y (m,) [m]."""
    reach = 4.0 * smoothness.path_filter + TAIL
    # The path begins behind the rear bumper at the first step: straight back from there, as the net's edges begin.
    ahead = np.searchsorted(odometer, min(odometer[0] + 5.0, odometer[-1]))
    back = (front[0] - front[ahead]) / max(float(np.hypot(*(front[0] - front[ahead]))), STANDING)
    points = np.concatenate([[front[0] + back * (length + reach)], front])
    travelled = np.concatenate([[odometer[0] - length - reach], odometer])
    grid = np.arange(travelled[0], travelled[-1] + PATH_STEP, PATH_STEP)
    raw = np.stack([np.interp(grid, travelled, points[:, i]) for i in range(2)])
    turning = _turning(raw)
    x, y = (
        (1.0 - turning) * smooth(line, smoothness.path_filter / PATH_STEP)
        + turning * smooth(line, TURN_FILTER / PATH_STEP)
        for line in raw
    )
    slope_x, slope_y = np.gradient(x, PATH_STEP), np.gradient(y, PATH_STEP)
    size = np.maximum(np.hypot(slope_x, slope_y), STANDING)
    turns = 2.0 * np.pi * grid / smoothness.wander_length + smoothness.wander_phase
    left = smoothness.offset + smoothness.wander * np.sin(turns)
    return grid, x - left * slope_y / size, y + left * slope_x / size


def _turning(path: FloatArray) -> FloatArray:
    """Returns the share (m,), from 0 to 1, to which points of `path` (2, m), PATH_STEP apart, are in a turn of the
    road.
    """
    near, far = round(TURN_NEAR / PATH_STEP), round(TURN_FAR / PATH_STEP)
    padded = np.pad(path, ((0, 0), (far, far)), "reflect", reflect_type="odd") if path.shape[1] > far else None
    if padded is None:
        return np.zeros(path.shape[1])
    count = path.shape[1]
    before = padded[:, far - near : far - near + count] - padded[:, :count]
    after = padded[:, 2 * far : 2 * far + count] - padded[:, far + near : far + near + count]
    cross, dot = before[0] * after[1] - before[1] * after[0], (before * after).sum(axis=0)
    turns = np.abs(np.arctan2(cross, dot)) > TURN
    return smooth(turns.astype(np.float64), TURN_FILTER / PATH_STEP)


def _unsteady(speed: FloatArray, smoothness: Smoothness) -> FloatArray:
    """Returns the way (k,) [m] by which the driver is ahead of a steady one with `speed` (k,) [m/s]."""
    deviation, limit = UNSTEADY_S / STEP_S, max(smoothness.unsteadiness, STANDING)
    noise = smooth(np.random.default_rng(smoothness.seed).normal(size=len(speed)), deviation)
    noise *= smoothness.unsteadiness * np.sqrt(2.0 * np.sqrt(np.pi) * deviation)  # back to the wanted deviation
    noise = np.tanh(noise / (UNSTEADY_MAX * limit)) * UNSTEADY_MAX * limit
    share = np.clip(smooth(speed, deviation) / UNSTEADY_SPEED, 0.0, 1.0)
    return noise * share * share


def smooth(values: FloatArray, deviation: float) -> FloatArray:
    """Returns `values` after a Gaussian filter of standard deviation `deviation` samples; ends are point-reflected."""
    reach = int(np.ceil(4.0 * deviation))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    before = 2.0 * values[0] - np.interp(np.arange(reach, 0, -1), np.arange(len(values)), values)
    behind = len(values) - 1 - np.arange(1, reach + 1)
    after = 2.0 * values[-1] - np.interp(behind, np.arange(len(values)), values)
    return np.convolve(np.concatenate([before, values, after]), kernel / kernel.sum(), mode="valid")
