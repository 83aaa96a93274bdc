"""Vehicle dynamics: a kinematic bicycle driven by acceleration and yaw rate, with limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from litsim_sim.core.quantities import Acceleration, Curvature, Number, Positive, Speed, configuration
from litsim_sim.core.scene import STEP_S, FloatArray


@configuration
class VehicleLimits:
    """What a controlled vehicle can do; commands beyond are cut.

    Attributes:
        acceleration_max: strongest acceleration.
        deceleration_max: strongest braking, dry asphalt.
        lateral_acceleration_max: yaw rate times speed.
        curvature_max: inverse of the smallest turning radius.
        speed_max: up to which it accelerates; one that is faster already may keep its speed.
        rear_axle: distance of the rear axle behind the box centre, as a share of the length.
    """

    acceleration_max: Positive[Acceleration] = 4.0
    deceleration_max: Positive[Acceleration] = 8.0
    lateral_acceleration_max: Positive[Acceleration] = 4.89
    curvature_max: Positive[Curvature] = 0.2
    speed_max: Positive[Speed] = 45.0
    rear_axle: Annotated[Number, Field(ge=0, le=0.5)] = 0.29


@dataclass(frozen=True)
class Motion:
    """Poses of box centres and their rates; arrays (n,), units as in :class:`litsim_sim.core.scene.AgentTable`."""

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    yaw_rate: FloatArray


def bicycle_step(
    motion: Motion, length: FloatArray, acceleration: FloatArray, yaw_rate: FloatArray, limits: VehicleLimits
) -> Motion:
    """One step of 0.1 s. The rear axle moves along the heading, at rest nothing rotates, no one reverses.

    Args:
        motion: state at the start of the step.
        length: (n,) [m], places the rear axle.
        acceleration, yaw_rate: (n,) commands [m/s2], [rad/s], cut to `limits`.

    Returns:
        state at the end of the step, with the acceleration and yaw rate that were really applied.
    """
    acceleration = np.clip(acceleration, -limits.deceleration_max, limits.acceleration_max)
    speed = np.clip(motion.speed + acceleration * STEP_S, 0.0, np.maximum(limits.speed_max, motion.speed))
    mean_speed = 0.5 * (motion.speed + speed)
    yaw_rate_max = np.minimum(
        mean_speed * limits.curvature_max, limits.lateral_acceleration_max / np.maximum(mean_speed, 1e-3)
    )
    yaw_rate = np.clip(yaw_rate, -yaw_rate_max, yaw_rate_max)
    yaw = motion.yaw + yaw_rate * STEP_S
    mean_yaw = motion.yaw + 0.5 * yaw_rate * STEP_S
    lever = limits.rear_axle * length
    x = motion.x + mean_speed * STEP_S * np.cos(mean_yaw) + lever * (np.cos(yaw) - np.cos(motion.yaw))
    y = motion.y + mean_speed * STEP_S * np.sin(mean_yaw) + lever * (np.sin(yaw) - np.sin(motion.yaw))
    return Motion(x, y, yaw, speed, (speed - motion.speed) / STEP_S, yaw_rate)
