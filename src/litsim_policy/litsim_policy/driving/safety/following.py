"""Accelerations with which agents do not run into those ahead on their paths, and stop at lines."""

from __future__ import annotations

import numpy as np

from litsim_policy.driving.safety.config import SafetyConfig
from litsim_policy.motion.car_following import GAP_MIN, LEADER_BRAKES, braking_behind, safe_speed
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import BOOLS2, FLOATS, FLOATS2, INTS, OUT_FLOATS, float64, kernel


def following_cap(config: SafetyConfig, agents: PathFollowers) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not stop behind the agent ahead on the path.

    The safe speed is that of Krauss (1997), at which `own_braking` suffices if the leader brakes by `leader_braking`.
    It is approached with `relax`, by no more than `widening`. If the approach to the leader, which is assumed to
    continue as now, needs more than `imminent`, the agent brakes accordingly at once.
    """
    view = agents.view
    leads = view.ahead & view.in_path
    return _cap_behind(config, agents, view.gap, view.speed, leads, view.first, agents.table.acceleration)


def stopping_cap(config: SafetyConfig, agents: PathFollowers, gap: FloatArray) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not stop at lines `gap` (m,) [m] ahead."""
    line = gap[:, None]
    nobody = np.zeros(len(gap), np.int64)
    return _cap_behind(config, agents, line, np.zeros(line.shape), np.isfinite(line), nobody, np.zeros(1))


def _cap_behind(
    config: SafetyConfig,
    agents: PathFollowers,
    gap: FloatArray,
    leader_speed: FloatArray,
    leads: BoolArray,
    first: IntArray,
    acceleration: FloatArray,
) -> FloatArray:
    """See :func:`following_cap`, behind the given leaders; for the arrays see :func:`_following_cap`."""
    return _following_cap(
        gap,
        leader_speed,
        leads,
        agents.speed,
        agents.table.length[agents.rows],
        first,
        acceleration,
        config.standstill_gap,
        config.own_braking,
        config.leader_braking,
        config.relax,
        config.widening,
        config.imminent,
        config.leader_brakes,
        config.braking_max,
        config.acceleration_max,
    )


def braking_needed(agents: PathFollowers, leads: BoolArray) -> FloatArray:
    """Constant braking (m,) [m/s2] with which agents do not reach their leaders (m, w).

    Unlike the car following, it does not react to gaps that are merely short. A leader that brakes is assumed to stop.
    """
    view = agents.view
    return _braking_needed(agents.speed, view.gap, view.speed, leads, view.first, agents.table.acceleration)


@kernel(OUT_FLOATS(FLOATS, FLOATS2, FLOATS2, BOOLS2, INTS, FLOATS))
def _braking_needed(
    speed: FloatArray,
    gap: FloatArray,
    along: FloatArray,
    leads: BoolArray,
    first: IntArray,
    acceleration: FloatArray,
) -> FloatArray:
    """See :func:`braking_needed`.

    Args:
        speed: (m,) of the agents [m/s].
        gap, along: (m, w) to others and of others along the path [m], [m/s].
        leads: (m, w) whether one of them leads.
        first: (m,) row of the first of the others.
        acceleration: (n,) of all agents [m/s2].
    """
    found = np.zeros(len(speed))
    for i in range(len(speed)):
        for j in range(gap.shape[1]):
            if leads[i, j]:
                lead, room, brakes = max(along[i, j], 0.0), max(gap[i, j], GAP_MIN), acceleration[first[i] + j]
                found[i] = max(found[i], braking_behind(speed[i], lead, brakes, room, LEADER_BRAKES))
    return found


@kernel(OUT_FLOATS(FLOATS2, FLOATS2, BOOLS2, FLOATS, FLOATS, INTS, FLOATS, *[float64] * 9))
def _following_cap(  # noqa: PLR0917 - a kernel takes arrays and numbers
    gap: FloatArray,
    leader_speed: FloatArray,
    leads: BoolArray,
    speed: FloatArray,
    length: FloatArray,
    first: IntArray,
    acceleration: FloatArray,
    standstill_gap: float,
    own_braking: float,
    leader_braking: float,
    relax: float,
    widening: float,
    imminent: float,
    leader_brakes: float,
    braking_max: float,
    acceleration_max: float,
) -> FloatArray:
    """See :func:`following_cap`.

    Args:
        gap, leader_speed: (m, w) to others and of others along the path [m], [m/s].
        leads: (m, w) whether one of them is ahead on the path.
        speed, length: (m,) of the agents [m/s], [m].
        first: (m,) position in `acceleration` of the first of the others.
        acceleration: (n,) of all agents [m/s2].
        standstill_gap, own_braking, leader_braking, relax, widening, imminent, leader_brakes, braking_max,
            acceleration_max: as in :class:`SafetyConfig`.
    """
    caps = np.empty(len(speed))
    for i in range(len(speed)):
        least = np.inf
        for j in np.flatnonzero(leads[i]):
            if not gap[i, j] > -0.5 * length[i]:
                continue
            room, lead = gap[i, j] - standstill_gap, max(leader_speed[i, j], 0.0)
            cap = max((safe_speed(room, lead, own_braking, leader_braking) - speed[i]) / relax, -widening)
            needed = braking_behind(speed[i], lead, acceleration[first[i] + j], room, leader_brakes)
            least = min(least, min(cap, -needed) if needed > imminent else cap)
        caps[i] = within(least, -braking_max, acceleration_max)
    return caps
