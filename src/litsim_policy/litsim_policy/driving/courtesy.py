"""Courtesy rules, which act earlier than guards: keep distance, make room, wait for crossing traffic.

Policy `yield` only stays in its lane if the side is taken; policy `litsim` applies all rules to its network.
"""

from __future__ import annotations

import math

import numpy as np

from litsim_policy.motion.car_following import LEADER_BRAKES, braking_behind, safe_speed
from litsim_policy.motion.path_kernels import UNIT_X, UNIT_Y, S, X, Y, segment_at
from litsim_sim.core.pair_geometry import overlap, within_scenes
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    BOOLS,
    BOOLS2,
    FLOATS,
    FLOATS2,
    FLOATS3,
    INTS,
    OUT_BOOLS,
    OUT_FLOATS,
    boolean,
    float64,
    int64,
    kernel,
)

FOLLOWING_TIME = 0.5  # [s] time constant of matching a leader's speed, nearer than the standstill gap
PEDALS = 3  # number of braking strengths, up to the hardest, that are tried to let an agent cross
TURNING_MIN = 1.0  # [m/s] least speed at which the yaw rate defines the arc of an agent
SAME_WAY = math.cos(math.pi / 4)  # cosine of the largest angle between headings of agents that do not cross


@kernel(OUT_FLOATS(FLOATS, FLOATS, FLOATS, FLOATS2, FLOATS2, BOOLS2, INTS, FLOATS, *[float64] * 6))
def distance_kept(  # noqa: PLR0917 - a kernel takes arrays and numbers
    wanted: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    gap: FloatArray,
    along: FloatArray,
    leads: BoolArray,
    first: IntArray,
    acceleration: FloatArray,
    standstill_gap: float,
    comfortable: float,
    courtesy: float,
    own_braking: float,
    leader_braking: float,
    relax: float,
) -> FloatArray:
    """Accelerations (m,) [m/s2] with which agents keep their distance to leaders, if less than they want.

    They drive no faster than is safe behind the leader, and slow down to that speed by at most comfortable braking.

    Once keeping `standstill_gap` takes more than comfortable braking, they brake constantly as that requires: harder
    than by `courtesy` only for half of that gap. Nearer than `standstill_gap` they slow down to the leader's speed.

    Args:
        wanted: (m,) accelerations [m/s2].
        speed, length: (m,) of the agents [m/s], [m].
        gap, along: (m, w) to others and of others along the path [m], [m/s].
        leads: (m, w) whether one of them leads.
        first: (m,) row of the first of the others.
        acceleration: (n,) of all agents [m/s2].
        standstill_gap: kept behind a leader that stands [m].
        comfortable, courtesy: braking [m/s2].
        own_braking, leader_braking: of the safe speed (:func:`litsim_policy.motion.car_following.safe_speed`) [m/s2].
        relax: time constant of the approach to the safe speed [s].
    """
    kept = wanted.copy()
    for i in range(len(speed)):
        soft, pressing = 0.0, 0.0
        for j in range(gap.shape[1]):
            if not (leads[i, j] and gap[i, j] > -0.5 * length[i]):
                continue
            safe = safe_speed(gap[i, j] - standstill_gap, max(along[i, j], 0.0), own_braking, leader_braking)
            kept[i] = min(kept[i], max((safe - speed[i]) / relax, -comfortable))
            if not gap[i, j] > 0.0:
                continue
            kept[i] = max(kept[i], -courtesy)
            lead, brakes = max(along[i, j], 0.0), acceleration[first[i] + j]
            room, least = gap[i, j] - standstill_gap, gap[i, j] - 0.5 * standstill_gap
            soft = max(soft, braking_behind(speed[i], lead, brakes, room, LEADER_BRAKES))
            pressing = max(pressing, braking_behind(speed[i], lead, brakes, least, LEADER_BRAKES))
        if soft > comfortable:
            kept[i] = min(kept[i], -max(min(soft, courtesy), pressing))
            continue
        for j in range(gap.shape[1]):
            if leads[i, j] and -0.5 * length[i] < gap[i, j] < standstill_gap:
                kept[i] = min(kept[i], (max(along[i, j], 0.0) - speed[i]) / FOLLOWING_TIME)
    return kept


@kernel(OUT_BOOLS(INTS, *[FLOATS] * 6, INTS, FLOATS, FLOATS2, *[float64] * 5))
def side_taken(  # noqa: PLR0917 - a kernel takes arrays and numbers
    scene: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    width: FloatArray,
    rows: IntArray,
    lane_heading: FloatArray,
    target: FloatArray,
    side_gap: float,
    side_horizon: float,
    side_margin: float,
    side_drift: float,
    coming_over: float,
) -> BoolArray:
    """Mask (m,) of agents that move to a side of their lanes where another agent is alongside, or soon will be.

    Args:
        scene, x, y, yaw, speed, length, width: (n,) of all agents.
        rows: (m,) of the agents.
        lane_heading: (m,) of their lanes [rad].
        target: (m, 2) points that they pursue [m].
        side_gap, side_horizon, side_margin, side_drift: as in :class:`YieldConfig`.
        coming_over: time for which merging agents are expected to continue [s].
    """
    taken, (begin, end) = np.zeros(len(rows), np.bool_), within_scenes(scene, rows)
    for i in range(len(rows)):
        own, cos, sin = rows[i], math.cos(lane_heading[i]), math.sin(lane_heading[i])
        move = -sin * (target[i, 0] - x[own]) + cos * (target[i, 1] - y[own])
        if not abs(move) > side_drift:
            continue
        for j in range(begin[i], end[i]):
            dx, dy = x[j] - x[own], y[j] - y[own]
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            faster = speed[j] - speed[own]
            reach = 0.5 * (length[j] + length[own]) + side_gap
            if np.sign(ahead) * faster < 0.0:
                reach += abs(faster) * side_horizon
            comes_over = -np.sign(left) * speed[j] * math.sin(yaw[j] - lane_heading[i])
            clearance = abs(left) - 0.5 * (width[j] + width[own]) - max(comes_over, 0.0) * coming_over
            if j != own and abs(ahead) < reach and left * move > 0.0 and clearance < abs(move) + side_margin:
                taken[i] = True
                break
    return taken


@kernel(OUT_FLOATS(FLOATS, INTS, *[FLOATS] * 7, INTS, FLOATS, *[float64] * 3))
def room_made(  # noqa: PLR0917 - a kernel takes arrays and numbers
    wanted: FloatArray,
    scene: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    length: FloatArray,
    width: FloatArray,
    rows: IntArray,
    lane_heading: FloatArray,
    side_gap: float,
    horizon: float,
    courtesy: float,
) -> FloatArray:
    """Accelerations (m,) [m/s2] with which agents make room for merging ones, if less than they want.

    A merging agent that would be alongside with its centre ahead is let in: they brake so as to be behind it by then,
    no harder than by `courtesy`.

    Args:
        wanted: (m,) accelerations [m/s2].
        scene, x, y, yaw, speed, acceleration, length, width: (n,) of all agents.
        rows: (m,) of the agents.
        lane_heading: (m,) of their lanes [rad].
        side_gap: gap between both [m].
        horizon: time for which all are assumed to continue, including their braking [s].
        courtesy: braking [m/s2].
    """
    made, (begin, end) = wanted.copy(), within_scenes(scene, rows)
    for i in range(len(rows)):
        own, cos, sin = rows[i], math.cos(lane_heading[i]), math.sin(lane_heading[i])
        along = speed[own] * math.cos(yaw[own] - lane_heading[i])
        across = speed[own] * math.sin(yaw[own] - lane_heading[i])
        for j in range(begin[i], end[i]):
            dx, dy = x[j] - x[own], y[j] - y[own]
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            clearance = abs(left) - 0.5 * (width[j] + width[own])
            over = -np.sign(left) * speed[j] * math.sin(yaw[j] - lane_heading[i])
            nearer = over + np.sign(left) * across
            if not (over > 0.0 and 0.0 < clearance < nearer * horizon):
                continue
            time = clearance / nearer
            faster = speed[j] * math.cos(yaw[j] - lane_heading[i]) - along
            then = ahead + faster * time + 0.5 * min(acceleration[j], 0.0) * time**2
            missing = 0.5 * (length[j] + length[own]) + side_gap - then
            if then >= 0.0 and missing > 0.0:
                made[i] = min(made[i], -min(2.0 * missing / time**2, courtesy))
    return made


@kernel(boolean(float64, FLOATS3, int64, int64, float64, *[FLOATS] * 8, int64, int64, float64, int64))
def _runs_into(  # noqa: PLR0917 - a kernel takes arrays and numbers
    pedal: float,
    segments: FloatArray,
    count: int,
    p: int,
    own_s: float,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    yaw_rate: FloatArray,
    length: FloatArray,
    width: FloatArray,
    own: int,
    j: int,
    margin: float,
    instants: int,
) -> bool:
    """Whether agent `own`, at acceleration `pedal` on path `p`, runs into agent `j` with the centre of `j` ahead."""
    s, other_x, other_y, other_yaw = own_s, x[j], y[j], yaw[j]
    bend = yaw_rate[j] / max(speed[j], TURNING_MIN)
    for k in range(instants):
        s += STEP_S * max(speed[own] + pedal * STEP_S * (k + 1), 0.0)
        gone = STEP_S * max(speed[j] + acceleration[j] * STEP_S * (k + 1), 0.0)
        other_yaw += bend * gone
        other_x += gone * math.cos(other_yaw)
        other_y += gone * math.sin(other_yaw)
        at = segment_at(segments, count, p, s)
        unit_x, unit_y = segments[p, at, UNIT_X], segments[p, at, UNIT_Y]
        along = s - segments[p, at, S]
        dx = other_x - (segments[p, at, X] + along * unit_x)
        dy = other_y - (segments[p, at, Y] + along * unit_y)
        heading = math.atan2(unit_y, unit_x)
        long, wide = length[j] + 2.0 * margin, width[j] + 2.0 * margin
        if overlap(dx, dy, heading, other_yaw, length[own], width[own], long, wide):
            return dx * unit_x + dy * unit_y > 0.0
    return False


@kernel(
    OUT_FLOATS(
        *(FLOATS, FLOATS3, INTS, FLOATS, INTS),
        *[FLOATS] * 8,
        *(BOOLS, INTS),
        *[float64] * 3,
    )
)
def crossing_awaited(  # noqa: PLR0917 - a kernel takes arrays and numbers
    wanted: FloatArray,
    segments: FloatArray,
    count: IntArray,
    own_s: FloatArray,
    scene: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    yaw_rate: FloatArray,
    length: FloatArray,
    width: FloatArray,
    off_log: BoolArray,
    rows: IntArray,
    margin: float,
    horizon: float,
    courtesy: float,
) -> FloatArray:
    """Accelerations (m,) [m/s2] with which agents wait for others that cross their paths, if less than they want.

    Others are assumed to continue along their arcs with their present acceleration. An agent that would run into the
    side of one brakes as little as necessary: by a third of `courtesy`, two thirds, or all of it.

    Args:
        wanted: (m,) accelerations [m/s2].
        segments, count, own_s: (m, L, 5), (m,), (m,) paths, and arc lengths of the agents on them [m].
        scene, x, y, yaw, speed, acceleration, yaw_rate, length, width: (n,) of all agents.
        off_log: (n,) whether an agent is off its log; the others are the conflict stage's concern.
        rows: (m,) of the agents.
        margin: kept around others [m].
        horizon: time for which others are assumed to continue so [s].
        courtesy: braking [m/s2].
    """
    made, (begin, end) = wanted.copy(), within_scenes(scene, rows)
    instants = round(horizon / STEP_S)
    for i in range(len(rows)):
        own = rows[i]
        for j in range(begin[i], end[i]):
            if j == own or not off_log[j] or math.cos(yaw[j] - yaw[own]) > SAME_WAY:
                continue
            dx, dy = x[j] - x[own], y[j] - y[own]
            reach = 0.5 * (length[j] + length[own]) + width[j] + width[own] + 2.0 * margin
            reach += horizon * (speed[own] + speed[j] + 0.5 * horizon * (max(made[i], 0.0) + max(acceleration[j], 0.0)))
            if not dx * dx + dy * dy < reach * reach:
                continue
            for k in range(PEDALS + 1):
                pedal = made[i] if k == 0 else min(made[i], -courtesy * k / PEDALS)
                if not _runs_into(
                    pedal,
                    segments,
                    count[i],
                    i,
                    own_s[i],
                    x,
                    y,
                    yaw,
                    speed,
                    acceleration,
                    yaw_rate,
                    length,
                    width,
                    own,
                    j,
                    margin,
                    instants,
                ):
                    break
            made[i] = pedal
    return made
