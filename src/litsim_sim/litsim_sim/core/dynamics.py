"""Vehicle dynamics: a kinematic bicycle driven by acceleration and yaw rate, with limits."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from litsim_sim.core.pair_geometry import within
from litsim_sim.core.quantities import Acceleration, Curvature, Number, Positive, Speed, configuration
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.kernels.compiled import Floats, kernel, tuple_of

SPEED_MIN = 1e-3  # [m/s] least speed in the bound on lateral acceleration


class LimitValues(NamedTuple):
    """The values of :class:`VehicleLimits`."""

    acceleration_max: float
    deceleration_max: float
    lateral_acceleration_max: float
    curvature_max: float
    speed_max: float
    rear_axle: float


@configuration
class VehicleLimits:
    """Limits of a controlled vehicle; commands beyond them are cut.

    Attributes:
        acceleration_max: strongest acceleration.
        deceleration_max: strongest braking, dry asphalt.
        lateral_acceleration_max: largest yaw rate times speed.
        curvature_max: inverse of the smallest turning radius.
        speed_max: speed up to which it accelerates; a vehicle that is faster already may keep its speed.
        rear_axle: distance of the rear axle behind the box centre, as a share of the length.
    """

    acceleration_max: Positive[Acceleration] = 4.0
    deceleration_max: Positive[Acceleration] = 8.0
    lateral_acceleration_max: Positive[Acceleration] = 4.89
    curvature_max: Positive[Curvature] = 0.2
    speed_max: Positive[Speed] = 45.0
    rear_axle: Annotated[Number, Field(ge=0, le=0.5)] = 0.29

    @cached_property
    def values(self) -> LimitValues:
        """The limits as kernels take them."""
        return tuple_of(LimitValues, self)


class Motion(NamedTuple):
    """Poses of box centres and their rates; arrays (n,), units as in :class:`litsim_sim.core.scene.AgentTable`."""

    x: Floats
    y: Floats
    yaw: Floats
    speed: Floats
    acceleration: Floats
    yaw_rate: Floats


def bicycle_step(
    motion: Motion, length: FloatArray, acceleration: FloatArray, yaw_rate: FloatArray, limits: VehicleLimits
) -> Motion:
    """Moves vehicles by one step of 0.1 s; rear axles along the heading, at rest nothing rotates, no one reverses.

    `length` (n,) [m] places the rear axle. The commands (n,) [m/s2], [rad/s] are cut to `limits`, and the result
    has what was really applied.
    """
    return Motion(*_bicycle_step(motion, length, acceleration, yaw_rate, limits.values))


@kernel
def _bicycle_step(
    motion: Motion, length: Floats, acceleration: Floats, yaw_rate: Floats, limits: LimitValues
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """See :func:`bicycle_step`; returns what :class:`Motion` holds."""
    x, y, yaw, speed, n = motion.x, motion.y, motion.yaw, motion.speed, len(length)
    new_x, new_y, new_yaw, new_speed = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    applied, turned = np.empty(n), np.empty(n)
    for i in range(n):
        wanted = speed[i] + within(acceleration[i], -limits.deceleration_max, limits.acceleration_max) * STEP_S
        new_speed[i] = within(wanted, 0.0, max(limits.speed_max, speed[i]))
        mean_speed = 0.5 * (speed[i] + new_speed[i])
        bound = min(mean_speed * limits.curvature_max, limits.lateral_acceleration_max / max(mean_speed, SPEED_MIN))
        turned[i] = within(yaw_rate[i], -bound, bound)
        new_yaw[i], mean_yaw = yaw[i] + turned[i] * STEP_S, yaw[i] + 0.5 * turned[i] * STEP_S
        way, lever = mean_speed * STEP_S, limits.rear_axle * length[i]
        new_x[i] = x[i] + way * math.cos(mean_yaw) + lever * (math.cos(new_yaw[i]) - math.cos(yaw[i]))
        new_y[i] = y[i] + way * math.sin(mean_yaw) + lever * (math.sin(new_yaw[i]) - math.sin(yaw[i]))
        applied[i] = (new_speed[i] - speed[i]) / STEP_S
    return new_x, new_y, new_yaw, new_speed, applied, turned
