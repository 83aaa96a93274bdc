"""Braking for agents ahead on the path: what is foreseen to be safe behind them, and what they require."""

from __future__ import annotations

import numpy as np

from litsim_policy.driving.safety.comfort import ACCELERATION_MAX
from litsim_policy.motion.car_following import GAP_MIN, LEADER_BRAKES, Leaders, braking_behind, safe_speed
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import BoolArray, FloatArray
from litsim_sim.kernels.compiled import Floats, kernel

LEADER_BRAKING, OWN_BRAKING = 5.0, 4.0  # [m/s2] that a leader may begin at any time, and in reply to it
STANDSTILL_GAP = 1.0  # [m] kept behind the leader
RELAX = 1.0  # [s] time constant of the approach to the safe speed
WIDENING = 2.5  # [m/s2] hardest braking only to widen a gap that is too short, outside emergencies
IMMINENT = 1.0  # [m/s2] an approach that needs harder braking is an emergency
BRAKING_MAX = 8.0  # [m/s2]


def following_cap(agents: PathFollowers) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not comfortably stop behind the agent ahead on the path.

    The safe speed is that of Krauss (1997), at which OWN_BRAKING suffices if the leader brakes by LEADER_BRAKING. It is
    approached with RELAX, by no more than WIDENING. If the approach to the leader, which is assumed to continue as now,
    needs more than IMMINENT, the agent brakes accordingly at once.
    """
    return _following_cap(agents.leaders, agents.speed, agents.table.length[agents.rows])


def braking_needed(agents: PathFollowers, leads: BoolArray) -> FloatArray:
    """Constant braking (m,) [m/s2] with which agents do not reach their leaders (m, w).

    Unlike the car following, it does not react to gaps that are merely short. A leader that brakes is assumed to stop.
    """
    return _braking_needed(agents.speed, agents.leaders._replace(leads=leads))


@kernel
def _braking_needed(speed: Floats, leaders: Leaders) -> Floats:
    """See :func:`braking_needed`; `speed` (m,) of the agents [m/s]."""
    needed = np.zeros(len(speed))
    for i in range(len(speed)):
        for j in range(leaders.gap.shape[1]):
            if leaders.leads[i, j]:
                lead, room = max(leaders.speed[i, j], 0.0), max(leaders.gap[i, j], GAP_MIN)
                brakes = leaders.acceleration[leaders.first[i] + j]
                needed[i] = max(needed[i], braking_behind(speed[i], lead, brakes, room, LEADER_BRAKES))
    return needed


@kernel
def _following_cap(leaders: Leaders, speed: Floats, length: Floats) -> Floats:
    """See :func:`following_cap`; `speed` and `length` (m,) of the agents [m/s], [m]."""
    caps = np.empty(len(speed))
    for i in range(len(speed)):
        least = np.inf
        for j in np.flatnonzero(leaders.leads[i]):
            if not leaders.gap[i, j] > -0.5 * length[i]:
                continue
            room, lead = leaders.gap[i, j] - STANDSTILL_GAP, max(leaders.speed[i, j], 0.0)
            safe = safe_speed(room, lead, OWN_BRAKING, LEADER_BRAKING)
            cap = max((safe - speed[i]) / RELAX, -WIDENING)
            brakes = leaders.acceleration[leaders.first[i] + j]
            needed = braking_behind(speed[i], lead, brakes, room, LEADER_BRAKES)
            least = min(least, min(cap, -needed) if needed > IMMINENT else cap)
        caps[i] = within(least, -BRAKING_MAX, ACCELERATION_MAX)
    return caps
