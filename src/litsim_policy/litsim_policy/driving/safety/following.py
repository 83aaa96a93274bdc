"""Accelerations with which agents do not run into those ahead on their paths, and stop at lines."""

from __future__ import annotations

import numpy as np

from litsim_policy.driving.safety.comfort import ACCELERATION_MAX
from litsim_policy.driving.safety.config import SAFETY, SafetyConfig, SafetyValues
from litsim_policy.motion.car_following import GAP_MIN, LEADER_BRAKES, LEADERS, Leaders, braking_behind, safe_speed
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import BoolArray, FloatArray
from litsim_sim.kernels.compiled import FLOATS, OUT_FLOATS, kernel

WIDENING = 2.5  # [m/s2] hardest braking only to widen a gap that is too short, outside emergencies


def following_cap(config: SafetyConfig, agents: PathFollowers) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not stop behind the agent ahead on the path.

    The safe speed is that of Krauss (1997), at which `own_braking` suffices if the leader brakes by `leader_braking`.
    It is approached with `relax`, by no more than :data:`WIDENING`. If the approach to the leader, which is assumed to
    continue as now, needs more than `imminent`, the agent brakes accordingly at once.
    """
    return _following_cap(agents.leaders, agents.speed, agents.table.length[agents.rows], config.values)


def stopping_cap(config: SafetyConfig, agents: PathFollowers, gap: FloatArray) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not stop at lines `gap` (m,) [m] ahead."""
    line = gap[:, None]
    lines = Leaders(line, np.zeros(line.shape), np.isfinite(line), np.zeros(len(gap), np.int64), np.zeros(1))
    return _following_cap(lines, agents.speed, agents.table.length[agents.rows], config.values)


def braking_needed(agents: PathFollowers, leads: BoolArray) -> FloatArray:
    """Constant braking (m,) [m/s2] with which agents do not reach their leaders (m, w).

    Unlike the car following, it does not react to gaps that are merely short. A leader that brakes is assumed to stop.
    """
    return _braking_needed(agents.speed, agents.leaders._replace(leads=leads))


@kernel(OUT_FLOATS(FLOATS, LEADERS))
def _braking_needed(speed: FloatArray, leaders: Leaders) -> FloatArray:
    """See :func:`braking_needed`; `speed` (m,) of the agents [m/s]."""
    needed = np.zeros(len(speed))
    for i in range(len(speed)):
        for j in range(leaders.gap.shape[1]):
            if leaders.leads[i, j]:
                lead, room = max(leaders.speed[i, j], 0.0), max(leaders.gap[i, j], GAP_MIN)
                brakes = leaders.acceleration[leaders.first[i] + j]
                needed[i] = max(needed[i], braking_behind(speed[i], lead, brakes, room, LEADER_BRAKES))
    return needed


@kernel(OUT_FLOATS(LEADERS, FLOATS, FLOATS, SAFETY))
def _following_cap(leaders: Leaders, speed: FloatArray, length: FloatArray, safety: SafetyValues) -> FloatArray:
    """See :func:`following_cap`; `speed` and `length` (m,) of the agents [m/s], [m]."""
    caps = np.empty(len(speed))
    for i in range(len(speed)):
        least = np.inf
        for j in np.flatnonzero(leaders.leads[i]):
            if not leaders.gap[i, j] > -0.5 * length[i]:
                continue
            room, lead = leaders.gap[i, j] - safety.standstill_gap, max(leaders.speed[i, j], 0.0)
            safe = safe_speed(room, lead, safety.own_braking, safety.leader_braking)
            cap = max((safe - speed[i]) / safety.relax, -WIDENING)
            brakes = leaders.acceleration[leaders.first[i] + j]
            needed = braking_behind(speed[i], lead, brakes, room, safety.leader_brakes)
            least = min(least, min(cap, -needed) if needed > safety.imminent else cap)
        caps[i] = within(least, -safety.braking_max, ACCELERATION_MAX)
    return caps
