"""Whether the ego's vehicle can do what an answer asks of it."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.scene import STEP_S, EgoCommand, FloatArray
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.tracking import CRAWL, EgoState, Trajectory, TwistTarget

SLACK = 1.05  # factor by which a demand may exceed a limit before it counts as clipped
SMALL = 1e-2  # [m/s2], [rad/s] excess that never counts as clipped


def is_clipped(target: EgoCommand | TwistTarget | Trajectory, ego: EgoState, vehicle: VehicleModel) -> bool:
    """Whether `target`, of finite values, asks for more than the vehicle can do.

    Args:
        target: acceleration and yaw rate; or speed and yaw rate to be reached within a step; or a trajectory, judged by
            its motion from pose to pose.
        ego: state of the ego at the step that is answered.
        vehicle: with the limits.
    """
    if isinstance(target, EgoCommand):
        return _exceeds(target.acceleration, target.yaw_rate, ego.speed, vehicle)
    if isinstance(target, TwistTarget):
        acceleration = (target.speed - ego.speed) / (STEP_S + 3.0 * vehicle.reaction_s)
        return _exceeds(acceleration, target.yaw_rate, ego.speed + STEP_S * max(acceleration, 0.0), vehicle)
    asked = np.stack(motion(target), axis=1).tolist()
    return any(_exceeds(acceleration, yaw_rate, speed, vehicle) for speed, acceleration, yaw_rate in asked)


def motion(trajectory: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Speed [m/s], acceleration [m/s2] and yaw rate [rad/s] about the inner poses of a trajectory, (m - 2,) each.

    The yaw rate is 0 where two poses are too close to each other to define a direction.
    """
    took = np.diff(trajectory.time)
    x, y = np.diff(trajectory.x), np.diff(trajectory.y)
    speed, heading = np.hypot(x, y) / took, np.arctan2(y, x)
    apart = 0.5 * (took[1:] + took[:-1])
    turn = np.remainder(np.diff(heading) + np.pi, 2.0 * np.pi) - np.pi
    moving = np.minimum(speed[1:], speed[:-1]) > CRAWL
    return np.maximum(speed[1:], speed[:-1]), np.diff(speed) / apart, np.where(moving, turn / apart, 0.0)


def _exceeds(acceleration: float, yaw_rate: float, speed: float, vehicle: VehicleModel) -> bool:
    cut = vehicle.within(acceleration, yaw_rate, speed)
    return any(abs(asked) > SLACK * abs(can) + SMALL for asked, can in zip((acceleration, yaw_rate), cut, strict=True))
