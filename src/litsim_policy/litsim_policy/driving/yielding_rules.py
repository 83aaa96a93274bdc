"""Rules by which agents yield, earlier than the guard acts: to leaders, opponents, crossing agents, walkers, cyclists.

Policy `yield` gives way, and stays in its lane if the side is taken. The other rules are those of driving on as the log
does (:class:`litsim_policy.driving.policy_c.PolicyC`).
"""

from __future__ import annotations

import math

import numpy as np

from litsim_policy.driving.look_ahead import ROUNDING
from litsim_policy.motion.along_path import AlongPath
from litsim_policy.motion.arcs import arc_of
from litsim_policy.motion.car_following import LEADER_BRAKES, IdmValues, Leaders, braking_behind, idm, safe_speed
from litsim_policy.motion.path_batch import PathBatch, nearest, place_at
from litsim_sim.core.pair_geometry import overlap, within_scenes
from litsim_sim.core.scene import STEP_S, AgentArrays, walks_or_cycles
from litsim_sim.kernels.compiled import Bools, Floats, Floats2, Ints, kernel

# [m/s2] hardest braking for an opponent that is ahead but not yet on the path, or alongside without being in the way
COURTESY_DECELERATION = 3.0
SIDE_GAP = 1.0  # [m] least gap behind and ahead for a lateral move
SIDE_HORIZON = 1.5  # [s] for which approaching agents are expected to continue
SIDE_MARGIN = 0.3  # [m] lateral distance kept to others
SIDE_DRIFT = 0.05  # [m] lateral distance that does not count as a move
LEADER_BRAKING, OWN_BRAKING = 3.1, 3.1  # [m/s2] of people at their hardest, who lead and who follow (train followers)
RELAX = 1.0  # [s] time constant of slowing down to the speed that is safe behind a leader
CROSSING_HORIZON = 3.0  # [s] for which crossing agents are expected to continue
FALLING_BACK = 4.0  # [s] in which an agent falls back behind one alongside, if their paths have met by then
CROSSING_MARGIN = 0.5  # [m] distance kept to crossing agents
FOLLOWING_TIME = 0.5  # [s] time constant of matching a leader's speed, nearer than the standstill gap
PEDALS = COURTESY_DECELERATION * np.array([1.0, 2.0, 3.0]) / 3.0
"""Braking [m/s2] that is tried to let an agent cross."""
EMERGENCIES = np.array([5.0, 8.0])
"""Harder braking [m/s2] for walkers and cyclists, who do not react, up to that of the guard: the most that vehicles can
do. Untuned."""
WALKING_MIN = 0.1  # [m/s] speed below which walkers and cyclists stand: nobody walks so slowly. Untuned
RETURN = 1.0  # [s] time constant with which agents return to their paths; that of `conflict.futures`
SAME_WAY = math.cos(math.pi / 4)  # cosine of the largest angle between headings of agents that do not cross


@kernel
def keep_distance(wanted: Floats, speed: Floats, length: Floats, leaders: Leaders, model: IdmValues) -> Floats:
    """Accelerations (m,) [m/s2] with which agents keep their distance to leaders, if less than they want.

    They drive no faster than is safe behind the leader (:func:`litsim_policy.motion.car_following.safe_speed`), and
    slow down to that speed by at most comfortable braking.

    Once keeping the standstill gap takes more than comfortable braking, they brake constantly as that requires:
    harder than by the courtesy deceleration only for a quarter of that gap. Nearer than the standstill gap they
    slow down to the leader's speed.
    """
    standstill_gap, comfortable = model.standstill_gap, model.deceleration
    gap, leads, first = leaders.gap, leaders.leads, leaders.first
    kept = wanted.copy()
    for i in range(len(speed)):
        soft, pressing = 0.0, 0.0
        for j in range(gap.shape[1]):
            if not (leads[i, j] and gap[i, j] > -0.5 * length[i]):
                continue
            room, lead = gap[i, j] - standstill_gap, max(leaders.speed[i, j], 0.0)
            safe = safe_speed(room, lead, OWN_BRAKING, LEADER_BRAKING)
            kept[i] = min(kept[i], max((safe - speed[i]) / RELAX, -comfortable))
            if not gap[i, j] > 0.0:
                continue
            kept[i] = max(kept[i], -COURTESY_DECELERATION)
            brakes, least = leaders.acceleration[first[i] + j], gap[i, j] - 0.25 * standstill_gap
            soft = max(soft, braking_behind(speed[i], lead, brakes, room, LEADER_BRAKES))
            pressing = max(pressing, braking_behind(speed[i], lead, brakes, least, LEADER_BRAKES))
        if soft > comfortable:
            kept[i] = min(kept[i], -max(min(soft, COURTESY_DECELERATION), pressing))
            continue
        for j in range(gap.shape[1]):
            if leads[i, j] and -0.5 * length[i] < gap[i, j] < standstill_gap:
                kept[i] = min(kept[i], (max(leaders.speed[i, j], 0.0) - speed[i]) / FOLLOWING_TIME)
    return kept


@kernel
def side_is_taken(agents: AgentArrays, rows: Ints, lane_heading: Floats, target: Floats2) -> Bools:
    """Mask (m,) of agents that move to a side of their lanes where another agent is alongside, or soon will be.

    They are in `rows` (m,), and pursue points `target` (m, 2) [m].
    """
    taken, (begin, end) = np.zeros(len(rows), np.bool_), within_scenes(agents.scene, rows)
    for i in range(len(rows)):
        own, cos, sin = rows[i], math.cos(lane_heading[i]), math.sin(lane_heading[i])
        move = -sin * (target[i, 0] - agents.x[own]) + cos * (target[i, 1] - agents.y[own])
        if not abs(move) > SIDE_DRIFT:
            continue
        for j in range(begin[i], end[i]):
            dx, dy = agents.x[j] - agents.x[own], agents.y[j] - agents.y[own]
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            faster = agents.speed[j] - agents.speed[own]
            reach = 0.5 * (agents.length[j] + agents.length[own]) + SIDE_GAP
            if np.sign(ahead) * faster < 0.0:
                reach += abs(faster) * SIDE_HORIZON
            clearance = abs(left) - 0.5 * (agents.width[j] + agents.width[own])
            if j != own and abs(ahead) < reach and left * move > 0.0 and clearance < abs(move) + SIDE_MARGIN:
                taken[i] = True
                break
    return taken


@kernel
def _goes_first(agents: AgentArrays, j: int, own: int) -> bool:
    """Whether the agent in row `j` has priority over that in row `own` when both are alongside; never mutual.

    Where paths cross, each agent can be ahead on the other's; along the mean direction of both headings only one is.
    """
    along = (agents.x[j] - agents.x[own]) * (math.cos(agents.yaw[j]) + math.cos(agents.yaw[own]))
    along += (agents.y[j] - agents.y[own]) * (math.sin(agents.yaw[j]) + math.sin(agents.yaw[own]))
    return along > 0.0 or (along == 0.0 and agents.id[j] < agents.id[own])


@kernel
def make_room(wanted: Floats, paths: PathBatch, own_s: Floats, agents: AgentArrays, rows: Ints) -> Floats:
    """Accelerations (m,) [m/s2] with which agents let others in that are alongside, if less than they want.

    Of two of these agents that are alongside and whose paths meet ahead, the one that is behind falls back, by no
    more than the courtesy deceleration. They are in `rows` (m,), at `own_s` (m,) [m] on their paths.
    """
    eased = wanted.copy()
    for i in range(len(rows)):
        own = rows[i]
        cos, sin = math.cos(agents.yaw[own]), math.sin(agents.yaw[own])
        for k in range(len(rows)):
            j = rows[k]
            dx, dy = agents.x[j] - agents.x[own], agents.y[j] - agents.y[own]
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            reach = 0.5 * (agents.length[j] + agents.length[own]) + SIDE_GAP
            apart = 0.5 * (agents.width[j] + agents.width[own])
            if not (abs(ahead) < reach and abs(left) > apart and agents.scene[j] == agents.scene[own]):
                continue
            if not (math.cos(agents.yaw[j] - agents.yaw[own]) > SAME_WAY and _goes_first(agents, j, own)):
                continue
            x, y, _, _ = place_at(paths, k, own_s[k] + agents.speed[j] * FALLING_BACK)
            if abs(nearest(paths, i, x, y)[2]) < apart:
                slower = agents.speed[j] - agents.speed[own]
                needed = 2.0 * (reach - ahead - slower * FALLING_BACK) / FALLING_BACK**2
                eased[i] = min(eased[i], -min(needed, COURTESY_DECELERATION))
    return eased


@kernel
def _contact_time(
    pedal: float, paths: PathBatch, p: int, own_s: float, agents: AgentArrays, own: int, j: int, arc: Floats2
) -> float:
    """Time [s] until agent `own`, at acceleration `pedal` on path `p`, runs into agent `j` on its `arc`; else infinity.

    It runs into `j` if the centre of `j` is ahead when the boxes meet, that of `j` with a margin around it; into
    walkers and cyclists, who do not look out for it, wherever they meet. Before these, the offset of `own` from its
    path counts, which fades.
    """
    walks = walks_or_cycles(agents.kind[j])
    offset = nearest(paths, p, agents.x[own], agents.y[own])[2] if walks else 0.0
    s, length, width = own_s, agents.length[own], agents.width[own]
    long, wide = agents.length[j] + 2.0 * CROSSING_MARGIN, agents.width[j] + 2.0 * CROSSING_MARGIN
    radius = 0.5 * (math.hypot(long, wide) + math.hypot(length, width)) + ROUNDING
    for k in range(len(arc)):
        s += STEP_S * max(agents.speed[own] + pedal * STEP_S * (k + 1), 0.0)
        x, y, unit_x, unit_y = place_at(paths, p, s)
        aside = offset * math.exp(-STEP_S * (k + 1) / RETURN)
        dx, dy = arc[k, 0] - x + aside * unit_y, arc[k, 1] - y - aside * unit_x
        if dx * dx + dy * dy < radius**2 and overlap(
            dx, dy, math.atan2(unit_y, unit_x), arc[k, 2], length, width, long, wide
        ):
            ahead = dx * unit_x + dy * unit_y > 0.0
            return STEP_S * k if ahead or walks else np.inf
    return np.inf


@kernel
def _in_reach(pedal: float, agents: AgentArrays, own: int, j: int) -> bool:
    """Whether agents `own`, at acceleration `pedal`, and `j` can meet within CROSSING_HORIZON, wherever they head."""
    dx, dy = agents.x[j] - agents.x[own], agents.y[j] - agents.y[own]
    reach = 0.5 * (agents.length[j] + agents.length[own]) + agents.width[j] + agents.width[own] + 2.0 * CROSSING_MARGIN
    faster = max(pedal, 0.0) + max(agents.acceleration[j], 0.0)
    reach += CROSSING_HORIZON * (agents.speed[own] + agents.speed[j] + 0.5 * CROSSING_HORIZON * faster)
    return dx * dx + dy * dy < reach * reach


@kernel
def _waits_for(agents: AgentArrays, own: int, j: int) -> bool:
    """Whether agent `own` waits for agent `j`: a walker or cyclist that moves, or a vehicle that heads another way."""
    if walks_or_cycles(agents.kind[j]):
        return agents.speed[j] > WALKING_MIN  # the distance rule keeps a standing one from being hit
    return j != own and not math.cos(agents.yaw[j] - agents.yaw[own]) > SAME_WAY


@kernel
def _pedal_for(wanted: float, paths: PathBatch, p: int, own_s: float, agents: AgentArrays, own: int, j: int) -> float:
    """Acceleration [m/s2] of agent `own`, at `own_s` [m] on path `p`, that lets agent `j` cross; `wanted` if any does.

    It is the least braking that avoids a contact, or the hardest where none does.
    """
    strengths = np.concatenate((PEDALS, EMERGENCIES)) if walks_or_cycles(agents.kind[j]) else PEDALS
    pedal, arc = wanted, arc_of(agents, j, agents.acceleration[j], round(CROSSING_HORIZON / STEP_S))
    for k in range(len(strengths) + 1):
        if k > 0:
            pedal = min(wanted, -strengths[k - 1])
        if _contact_time(pedal, paths, p, own_s, agents, own, j, arc) == np.inf:
            break
    return pedal


@kernel
def wait_for_crossing(
    wanted: Floats, paths: PathBatch, own_s: Floats, agents: AgentArrays, rows: Ints, others: Bools
) -> Floats:
    """Accelerations (m,) [m/s2] with which agents wait for `others` that cross their paths, if less than they want.

    An agent that would run into the side of one (:func:`_contact_time`) brakes as little as necessary: by a third of
    the courtesy deceleration, two thirds, or all of it; for walkers and cyclists, as hard as it can if that is not
    enough. The mask `others` is (n,); all other arguments are those of :func:`make_room`.
    """
    eased, (begin, end) = wanted.copy(), within_scenes(agents.scene, rows)
    for i in range(len(rows)):
        own = rows[i]
        for j in range(begin[i], end[i]):
            if others[j] and _waits_for(agents, own, j) and _in_reach(eased[i], agents, own, j):
                eased[i] = _pedal_for(eased[i], paths, i, own_s[i], agents, own, j)
    return eased


@kernel
def give_way(
    view: AlongPath, agents: AgentArrays, rows: Ints, wanted_speed: Floats, opponent: Ints, model: IdmValues
) -> Floats:
    """Accelerations (m,) [m/s2] with which agents follow others on their paths, and give way.

    They give way to their opponents, by id, and to those alongside that are ahead: by the car following, but no
    harder than by the courtesy deceleration for those that are not in the way. On a free road they would drive at
    `wanted_speed`.
    """
    acceleration = np.empty(len(rows))
    gap, ahead, in_path, count = view.gap, view.ahead, view.in_path, view.gap.shape[1]
    leads, courted = np.empty(count, np.bool_), np.empty(count, np.bool_)
    for i in range(len(rows)):
        speed, courted_any, in_the_way = agents.speed[rows[i]], False, False
        for j in range(count):
            other = view.first[i] + j
            leads[j] = ahead[i, j] and in_path[i, j] and gap[i, j] > 0.0
            courted[j] = ahead[i, j] and (in_path[i, j] or agents.id[other] == opponent[i]) and not leads[j]
            if courted[j] and not gap[i, j] > 0.0:
                courted[j] = _goes_first(agents, other, rows[i])
            if courted[j]:
                courted_any = True
                in_the_way = in_the_way or (view.aside[i, j] < 0.0 and view.speed[i, j] < speed)
        acceleration[i] = idm(speed, wanted_speed[i], gap[i], view.speed[i], leads, model)
        if courted_any:
            courtesy = idm(speed, wanted_speed[i], gap[i], view.speed[i], courted, model)
            if not in_the_way:
                courtesy = max(courtesy, -COURTESY_DECELERATION)
            acceleration[i] = min(acceleration[i], courtesy)
    return acceleration
