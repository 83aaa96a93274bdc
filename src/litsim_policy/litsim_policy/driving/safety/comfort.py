"""Commands within comfort: bounds on accelerations and turns, and on how fast both change."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.dynamics import SPEED_MIN
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import STEP_S, AgentArrays
from litsim_sim.kernels.compiled import Floats, Floats2, Ints, kernel

# Limits of the network's commands, those of nuPlan's comfort measure unless stated otherwise.
ACCELERATION_MAX, DECELERATION_MAX = 2.40, 4.05  # [m/s2]
JERK_MAX = 4.13  # [m/s3] with which acceleration grows, and braking is eased
# [m/s3] with which braking grows. With 4.13 m/s3 it would take a second to brake as hard as people do within a quarter
# of one; this is nuPlan's bound on the whole jerk. The careful and competent driver of UN Regulation 157 has 12.65.
BRAKING_JERK_MAX = 8.37
LATERAL_ACCELERATION_MAX = 4.89  # [m/s2]
YAW_RATE_MAX = 0.95  # [rad/s]
YAW_ACCELERATION_MAX = 1.93  # [rad/s2]


@kernel
def limited(acceleration: Floats, yaw_rate: Floats, agents: AgentArrays, rows: Ints) -> Floats2:
    """Returns commands (m, 2) within the comfort bounds, those on the rates of change included.

    If the motion in the last step was out of bounds, it returns at the largest rate of change. The agents are in
    `rows` (m,); requests are (m,) [m/s2], [rad/s].
    """
    limited = np.empty((len(rows), 2))
    rise, fall = JERK_MAX * STEP_S, BRAKING_JERK_MAX * STEP_S
    turn_step = YAW_ACCELERATION_MAX * STEP_S
    for i in range(len(rows)):
        own = rows[i]
        before = within(agents.acceleration[own], -DECELERATION_MAX, ACCELERATION_MAX)
        pedal = within(acceleration[i], before - fall, before + rise)
        bound = min(YAW_RATE_MAX, LATERAL_ACCELERATION_MAX / max(agents.speed[own], SPEED_MIN))
        turn = within(yaw_rate[i], agents.yaw_rate[own] - turn_step, agents.yaw_rate[own] + turn_step)
        limited[i, 0] = within(pedal, -DECELERATION_MAX, ACCELERATION_MAX)
        limited[i, 1] = within(turn, -bound, bound)
    return limited
