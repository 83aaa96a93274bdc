"""Commands within comfort: bounds on accelerations and turns, and on how fast both change."""

from __future__ import annotations

import numpy as np
from numba.types import Tuple

from litsim_policy.driving.safety.config import SAFETY, SafetyValues
from litsim_sim.core.dynamics import SPEED_MIN
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import AGENTS, STEP_S, AgentArrays, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import FLOATS, INTS, OUT_BOOLS, OUT_FLOATS2, kernel

SAME = 1e-9  # [m/s2], [rad/s] up to which a command counts as unchanged


@kernel(Tuple((OUT_FLOATS2, OUT_BOOLS))(FLOATS, FLOATS, AGENTS, INTS, SAFETY))
def limited(
    acceleration: FloatArray, yaw_rate: FloatArray, agents: AgentArrays, rows: IntArray, safety: SafetyValues
) -> tuple[FloatArray, BoolArray]:
    """Commands within the comfort bounds, those on the rates of change included.

    If the motion in the last step was out of bounds, it returns at the largest rate of change.

    Args:
        acceleration, yaw_rate: (m,) requested [m/s2], [rad/s].
        agents: all agents.
        rows: (m,) of the agents that are commanded.
        safety: the bounds.

    Returns:
        the commands (m, 2), and which of them differ from the request (m,).
    """
    limited, changed = np.empty((len(rows), 2)), np.empty(len(rows), np.bool_)
    rise, fall = safety.jerk_max * STEP_S, safety.braking_jerk_max * STEP_S
    turn_step = safety.yaw_acceleration_max * STEP_S
    for i in range(len(rows)):
        own = rows[i]
        before = within(agents.acceleration[own], -safety.deceleration_max, safety.acceleration_max)
        pedal = within(acceleration[i], before - fall, before + rise)
        bound = min(safety.yaw_rate_max, safety.lateral_acceleration_max / max(agents.speed[own], SPEED_MIN))
        turn = within(yaw_rate[i], agents.yaw_rate[own] - turn_step, agents.yaw_rate[own] + turn_step)
        limited[i, 0] = within(pedal, -safety.deceleration_max, safety.acceleration_max)
        limited[i, 1] = within(turn, -bound, bound)
        acceleration_change, yaw_rate_change = limited[i, 0] - acceleration[i], limited[i, 1] - yaw_rate[i]
        changed[i] = abs(acceleration_change) > SAME or abs(yaw_rate_change) > SAME
    return limited, changed
