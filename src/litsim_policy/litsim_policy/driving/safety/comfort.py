"""Commands within comfort: bounds on accelerations and turns, and on how fast both change."""

from __future__ import annotations

import numpy as np
from numba.types import Tuple

from litsim_sim.core.dynamics import SPEED_MIN
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray
from litsim_sim.kernels.compiled import FLOATS, OUT_BOOLS, OUT_FLOATS2, float64, kernel

SAME = 1e-9  # [m/s2], [rad/s] up to which a command counts as unchanged


@kernel(Tuple((OUT_FLOATS2, OUT_BOOLS))(*[FLOATS] * 5, *[float64] * 7))
def limited(  # noqa: PLR0917 - a kernel takes arrays and numbers
    asked_acceleration: FloatArray,
    asked_yaw_rate: FloatArray,
    acceleration: FloatArray,
    yaw_rate: FloatArray,
    speed: FloatArray,
    deceleration_max: float,
    acceleration_max: float,
    jerk_max: float,
    braking_jerk_max: float,
    yaw_rate_max: float,
    lateral_acceleration_max: float,
    yaw_acceleration_max: float,
) -> tuple[FloatArray, BoolArray]:
    """Commands within the comfort bounds, those on the rates of change included.

    If the motion in the last step was out of bounds, it returns at the largest rate of change.

    Args:
        asked_acceleration, asked_yaw_rate: (m,) requested [m/s2], [rad/s].
        acceleration, yaw_rate, speed: (m,) of the agents in the last step and now [m/s2], [rad/s], [m/s].
        deceleration_max, acceleration_max, jerk_max, braking_jerk_max, yaw_rate_max, lateral_acceleration_max,
            yaw_acceleration_max: as in :class:`SafetyConfig`.

    Returns:
        the commands (m, 2), and which of them differ from the request (m,).
    """
    limited, changed = np.empty((len(speed), 2)), np.empty(len(speed), np.bool_)
    rise, fall, turn_step = jerk_max * STEP_S, braking_jerk_max * STEP_S, yaw_acceleration_max * STEP_S
    for i in range(len(speed)):
        before = within(acceleration[i], -deceleration_max, acceleration_max)
        pedal = within(asked_acceleration[i], before - fall, before + rise)
        bound = min(yaw_rate_max, lateral_acceleration_max / max(speed[i], SPEED_MIN))
        turn = within(asked_yaw_rate[i], yaw_rate[i] - turn_step, yaw_rate[i] + turn_step)
        limited[i, 0] = within(pedal, -deceleration_max, acceleration_max)
        limited[i, 1] = within(turn, -bound, bound)
        acceleration_change, yaw_rate_change = limited[i, 0] - asked_acceleration[i], limited[i, 1] - asked_yaw_rate[i]
        changed[i] = abs(acceleration_change) > SAME or abs(yaw_rate_change) > SAME
    return limited, changed
