"""Conversion of a driving system's targets (speeds, or trajectories to be tracked) to acceleration and yaw rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.core.vehicle import VehicleModel

BANDWIDTH = 2.0  # [rad/s] bandwidth of the error dynamics of a vehicle without actuators
SLOW = 2.0  # [m/s] speed below which steering towards the path does not become stronger
CRAWL = 0.3  # [m/s] speed below which the direction of motion is not reliable
PREVIEW = 0.25  # [s] half the window over which speed and heading of a trajectory are differentiated
STOP = 2.0  # [m/s2] braking once a trajectory is over
WAIT_MAX = 10.0  # [s] from the step to the first pose of a trajectory, at most: later ones have stamps of another clock
OFFSET_MAX = 2.0  # [m] largest distance between the ego and a new trajectory
HASTE = 2.0  # [m/s] by which a trajectory may be faster than the vehicle can be
ROUNDING = 0.1  # [m] tolerance in addition


@dataclass(frozen=True)
class EgoState:
    """The ego at a step: box centre [m], heading [rad], speed [m/s], in frame map; `length` [m] of its box."""

    time: float
    x: float
    y: float
    yaw: float
    speed: float
    length: float


@dataclass(frozen=True)
class TwistTarget:
    """Target speed [m/s] and yaw rate [rad/s] of the ego."""

    speed: float
    yaw_rate: float


@dataclass(frozen=True)
class Trajectory:
    """Target positions of the ego's box centre: (m,) simulation time [s], strictly ascending, x, y in frame map [m]."""

    time: FloatArray
    x: FloatArray
    y: FloatArray


def follow_twist(target: TwistTarget, ego: EgoState, vehicle: VehicleModel) -> tuple[float, float]:
    """Acceleration and yaw rate: the target is reached in one step, slower behind actuators, within the limits.

    The yaw rate is cut to the limit at the mean speed of the step, not at a target speed that the step cannot reach.
    """
    acceleration = vehicle.possible((max(target.speed, 0.0) - ego.speed) / (STEP_S + 3.0 * vehicle.reaction_s))
    return vehicle.within(acceleration, target.yaw_rate, ego.speed + 0.5 * STEP_S * acceleration)


class Reference:
    """A trajectory as a motion over time, and the law by which the ego tracks it.

    Speed and heading are those of the way between the poses, at the middle of each interval, and linear in time
    between. Poses are linear in time. One that begins at the next step is prolonged back to now; before one that begins
    later, the ego drives to its first pose.
    """

    def __init__(self, trajectory: Trajectory, ego: EgoState) -> None:
        time, places = trajectory.time, trajectory.x + 1j * trajectory.y
        self._empty = not len(time)
        self._first = ego.time if self._empty else float(time[0])
        later, begun = self._empty or time[0] > ego.time + 0.5 * STEP_S, 0
        if later:
            begin = complex(ego.x, ego.y)
            if len(time) > 1 and time[0] < ego.time + 1.5 * STEP_S:
                begin, begun = _before(time, places, ego.time), 1
            time, places = np.append(ego.time, time), np.append(begin, places)
        self._time, self._x, self._y = time, places.real, places.imag
        took, way = np.diff(time)[begun:], np.diff(places)[begun:]
        middle = time[begun:-1] + 0.5 * took
        speed = np.abs(way) / took
        moving = speed > CRAWL
        heading, times = np.angle(way)[moving], middle[moving]
        if not len(times):
            heading, times = np.array([ego.yaw]), np.array([ego.time])
        if not len(middle) or ego.time < middle[0]:
            speed, middle = np.append(ego.speed, speed), np.append(ego.time, middle)
        self._speed, self._middle = speed, middle
        self._heading, self._heading_time = np.unwrap(heading), times

    def problem(self, ego: EgoState, vehicle: VehicleModel) -> str:
        """Returns a text that says why the vehicle cannot follow the trajectory; empty if it can."""
        if self._empty:
            return "it holds no poses, expected some after the step"
        if self._time[-1] <= ego.time:
            return f"its last pose is for {self._time[-1]:.1f} s, expected one after {ego.time:.1f} s"
        if self._first > ego.time + WAIT_MAX:
            return (
                f"its first pose is for {self._first:.1f} s, expected one for {ego.time + WAIT_MAX:.1f} s or earlier: "
                "stamps are in simulation time"
            )
        away = float(np.hypot(*self._offset(ego.time, ego)))
        if away > OFFSET_MAX:
            return f"it is {away:.1f} m away from the ego, expected at most {OFFSET_MAX:g} m"
        took, went = np.diff(self._time), np.hypot(np.diff(self._x), np.diff(self._y))
        fastest = np.maximum(ego.speed, vehicle.speed_max)
        ahead = np.maximum(self._time[1:] - ego.time, 0.0)
        reached = np.minimum(ego.speed + vehicle.acceleration_max * ahead, fastest)
        allowed = (reached + HASTE) * took + ROUNDING
        jumps = np.flatnonzero((went > allowed) & (self._time[1:] > ego.time))
        if not len(jumps):
            return ""
        i = int(jumps[0])
        return (
            f"it jumps by {went[i]:.2f} m within {took[i]:.2g} s up to {self._time[i + 1]:.1f} s, expected at most "
            f"{allowed[i]:.2f} m"
        )

    def command(self, ego: EgoState, vehicle: VehicleModel) -> tuple[float, float]:
        """Acceleration [m/s2] and yaw rate [rad/s] by which the ego tracks the trajectory, within its limits.

        Feed-forward of the trajectory's own, read ahead by the delay of the actuators, and feedback of the errors along
        and across its heading, as in Kanayama et al., "A stable tracking control method for an autonomous mobile
        robot" (ICRA 1990), critically damped in time at every speed. Once the trajectory is over, the ego brakes on
        the last arc.
        """
        now, over = ego.time, ego.time >= self._time[-1]
        ahead = now + vehicle.reaction_s + 0.5 * STEP_S
        rate = self._slope(self._heading_time, self._heading, ahead)
        speed = self._at(self._middle, self._speed, now)
        curvature = rate / max(self._at(self._middle, self._speed, ahead), SLOW)
        if over:
            return vehicle.within(-STOP, ego.speed * curvature, ego.speed)
        bandwidth = BANDWIDTH / (1.0 + 2.0 * BANDWIDTH * vehicle.reaction_s)
        # The centre of a box is ahead of its rear axle, so in a bend it does not move along the heading.
        slip = float(np.arcsin(np.clip(vehicle.rear_axle * ego.length * curvature, -0.9, 0.9)))
        early = max(float(self._heading_time[0]) - now, 0.0)
        heading = self._at(self._heading_time, self._heading, now) - rate * early - slip
        e_heading = float(wrap_angle(np.asarray(heading - ego.yaw)))
        if early:  # it begins now, as the box or as its centre heads
            e_heading -= float(np.clip(e_heading, min(0.0, -slip), max(0.0, -slip)))
        dx, dy = self._offset(now, ego)
        e_along, e_across = (float(e) for e in to_body(np.asarray(dx), np.asarray(dy), np.asarray(heading)))
        acceleration = (
            self._slope(self._middle, self._speed, ahead)
            + 2.0 * bandwidth * (speed - ego.speed)
            + bandwidth**2 * e_along
        )
        yaw_rate = rate + bandwidth**2 * e_across / max(ego.speed, SLOW) + 2.0 * bandwidth * float(np.sin(e_heading))
        possible = vehicle.possible(acceleration)
        return vehicle.within(possible, yaw_rate, ego.speed + 0.5 * STEP_S * max(possible, 0.0))

    def _offset(self, time: float, ego: EgoState) -> tuple[float, float]:
        """Vector from the ego to the trajectory at `time` [m], in frame map."""
        return self._at(self._time, self._x, time) - ego.x, self._at(self._time, self._y, time) - ego.y

    def _at(self, times: FloatArray, values: FloatArray, time: float) -> float:
        return float(np.interp(time, times, values))

    def _slope(self, times: FloatArray, values: FloatArray, time: float) -> float:
        """Derivative about `time`, over a window that ends where the trajectory does."""
        low, high = np.clip([time - PREVIEW, time + PREVIEW], times[0], times[-1])
        if high - low < 0.5 * STEP_S:  # beyond the ends: the last there is
            low, high = (times[0], times[0] + PREVIEW) if time < times[0] else (times[-1] - PREVIEW, times[-1])
        change = np.interp(high, times, values) - np.interp(low, times, values)
        return float(change / (high - low))


def _before(time: FloatArray, places: NDArray[np.complex128], now: float) -> complex:
    """Returns where a motion through `places` (m,), at least two, at `time` (m,) [s] was `now`, shortly before."""
    took = np.diff(time[:3])
    velocity = np.diff(places[:3]) / took
    turns = len(took) > 1 and np.abs(velocity).min() > CRAWL
    rate = float(np.angle(velocity[1] / velocity[0])) / (0.5 * took.sum()) if turns else 0.0
    back = float(time[0]) - now
    return complex(places[0] - back * velocity[0] * np.exp(-0.5j * rate * (back + took[0])))
