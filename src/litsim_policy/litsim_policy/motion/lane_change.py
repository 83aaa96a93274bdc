"""MOBIL (Kesting, Treiber, Helbing 2007): gain of a lane change for its driver, loss of others, and safety.

Accelerations are those of the Intelligent Driver Model, now and as if the change were made at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_policy.motion.along_path import AlongPath
from litsim_policy.motion.car_following import IdmValues, idm
from litsim_sim.core.scene import AgentArrays, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Bools, Bools2, Floats, Ints, kernel

NOBODY = -1
POLITENESS = 0.2  # weight of the gains and losses of others, relative to the agent's own
GAIN_MIN = 0.2  # [m/s2] least gain that is worth a change
BRAKING_SAFE = 3.0
"""Most braking [m/s2] that the new follower, or the agent itself behind its new leader, may need.

With 4 m/s2, there were 64 hard brakes instead of 49."""
GAP_MIN = 2.0  # [m] least gap ahead and behind, bumper to bumper
HEADWAY = 0.5  # [s] T of the car following, which drivers accept during a lane change; more left agents beside gaps
STANDSTILL_GAP, ACCELERATION_MAX, DECELERATION, BRAKING_MAX = 1.5, 2.0, 2.5, 8.0  # [m], [m/s2] s0, a_max, b, limit
LEVEL_SPEED = 1.0  # [m/s] lower bound on speeds in denominators
SWING = 0.57  # share of a lane change after which a car is clear of the lane that it leaves


@dataclass
class LaneChanges:
    """Consequences of k lane changes; arrays (k,).

    Attributes:
        gain: of the driver and, weighted by POLITENESS, of others [m/s2].
        safe: whether the change may begin: no agent has to brake harder than is safe, gaps are kept, and the agent's
            leader can be passed in time.
        room: whether a change that has begun can continue: no agent is alongside, or approaches so fast that it would
            have to brake harder than is safe.
    """

    gain: FloatArray
    safe: BoolArray
    room: BoolArray


def weigh_changes(
    table: AgentTable,
    rows: IntArray,
    wanted: FloatArray,
    view: AlongPath,
    claimed: BoolArray,
    reach: FloatArray,
) -> LaneChanges:
    """Weigh one lane change for each of the k agents in `rows`, which want to drive at speeds `wanted` [m/s].

    The `view` (2 k, w) is first relative to each agent on the centre line of its own lane, then as if it were on
    that of the target lane. Agents `claimed` (mask (k, w)) are changing to the target lane, and count as being in
    it. A change takes `reach` (k,) of road [m].
    """
    return LaneChanges(*_weigh(table.arrays, rows, wanted, view, claimed, reach))


@kernel
def _behind(speed: float, desired_speed: float, gap: float, leader_speed: float) -> float:
    """Acceleration [m/s2] of the car following behind one leader; an infinite gap means a free road."""
    gaps, speeds, leads = np.empty(1), np.empty(1), np.empty(1, np.bool_)
    gaps[0], speeds[0], leads[0] = gap, leader_speed, gap < np.inf
    model = IdmValues(HEADWAY, STANDSTILL_GAP, ACCELERATION_MAX, DECELERATION, BRAKING_MAX)
    return idm(speed, desired_speed, gaps, speeds, leads, model)


@kernel
def _leader(gap: Floats, ahead: Bools, in_lane: Bools, me: int) -> tuple[int, float]:
    """Column of the first of w agents ahead in a lane, and the gap to it [m]; NOBODY and infinity if there is none."""
    first, least = NOBODY, np.inf
    for j in range(len(gap)):
        if j != me and ahead[j] and in_lane[j] and gap[j] < least:
            first, least = j, gap[j]
    return first, least


@kernel
def _follower(s: Floats, length: Floats, ahead: Bools, in_lane: Bools, me: int) -> tuple[int, float]:
    """Column of the first agent behind in a lane, likewise; the gap is negative if it is alongside."""
    first, least = NOBODY, np.inf
    for j in range(len(s)):
        if j == me or ahead[j] or not in_lane[j] or s[j] == -np.inf:
            continue
        gap = s[me] - s[j] - 0.5 * (length[me] + length[j])
        if gap < least:
            first, least = j, gap
    return first, least


@kernel
def _weigh(
    agents: AgentArrays, rows: Ints, wanted: Floats, view: AlongPath, claimed: Bools2, reach: Floats
) -> tuple[Floats, Bools, Bools]:
    """Return the fields of :class:`LaneChanges`; see :func:`weigh_changes`.

    The desired speed of a follower is assumed to be its present speed.
    """
    gain, safe, room = np.empty(len(rows)), np.empty(len(rows), np.bool_), np.empty(len(rows), np.bool_)
    comes = np.empty(view.s.shape[1], np.bool_)
    for i in range(len(rows)):
        there = len(rows) + i
        for j in range(len(comes)):
            comes[j] = view.in_path[there, j] or (claimed[i, j] and view.s[there, j] > -np.inf)
        me, own = rows[i] - view.first[i], agents.speed[rows[i]]
        # fewer than the columns, the rest of which are empty
        lengths = agents.length[view.first[i] : view.first[i] + len(comes)]
        old_leader, old_gap = _leader(view.gap[i], view.ahead[i], view.in_path[i], me)
        new_leader, new_gap = _leader(view.gap[there], view.ahead[there], comes, me)
        old_follower, old_back = _follower(view.s[i], lengths, view.ahead[i], view.in_path[i], me)
        follower, back = _follower(view.s[there], lengths, view.ahead[there], comes, me)
        old_speed = 0.0 if old_leader < 0 else view.speed[i, old_leader]
        new_speed = 0.0 if new_leader < 0 else view.speed[there, new_leader]
        now = _behind(own, wanted[i], old_gap, old_speed)
        then = _behind(own, wanted[i], new_gap, new_speed)
        others, braking = 0.0, 0.0
        room[i] = new_gap > 0.0 and back > 0.0
        room[i] = room[i] and max(own - new_speed, 0.0) ** 2 <= 2.0 * BRAKING_SAFE * new_gap
        if follower >= 0:
            its = view.speed[there, follower]
            before = _behind(its, its, back + lengths[me] + new_gap, new_speed)
            braking = _behind(its, its, back, own)
            others += braking - before
            room[i] = room[i] and max(its - own, 0.0) ** 2 <= 2.0 * BRAKING_SAFE * back
        if old_follower >= 0:
            its = view.speed[i, old_follower]
            before = _behind(its, its, old_back, own)
            others += _behind(its, its, old_back + lengths[me] + old_gap, old_speed) - before
        gain[i] = then - now + POLITENESS * others
        safe[i] = braking >= -BRAKING_SAFE and then >= -BRAKING_SAFE
        safe[i] = safe[i] and new_gap >= GAP_MIN and back >= GAP_MIN
        if old_leader >= 0:  # the agent must be clear of its lane before it reaches the leader
            share = min(max(old_speed / max(own, LEVEL_SPEED), 0.0), 1.0)
            safe[i] = safe[i] and old_gap >= SWING * reach[i] * (1.0 - share)
    return gain, safe, room
