"""Where other agents are relative to vehicles on their paths: ahead, in the way, beside."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from litsim_policy.motion.car_following import Leaders
from litsim_policy.motion.path_batch import SLACK, UNIT_X, UNIT_Y, PathBatch, S, X, Y, nearest, nearest_of
from litsim_sim.core.pair_geometry import within, within_scenes
from litsim_sim.core.scene import AgentArrays, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Bools2, Bools3, Floats, Floats2, Floats3, Ints, Ints2, kernel

SIGHT = 120.0  # [m] distance beyond which agents are ignored
MARGIN = 0.2  # [m] default lateral distance kept to others
MERGE = 15.0  # [m] distance within which a vehicle beside its path is assumed to move onto it

Poses = tuple[FloatArray, FloatArray, FloatArray]
"""x, y [m] and yaw [rad] of m agents; arrays (m,)."""


class PoseArrays(NamedTuple):
    """:data:`Poses` as kernels take them."""

    x: Floats
    y: Floats
    yaw: Floats


class AlongPath(NamedTuple):
    """The agents of a scene relative to a vehicle on its path, or relative to m vehicles, each in its own scene.

    Arrays are (w,) or (m, w) unless stated otherwise: column c is the agent in row `first` + c of the table, and w is
    the number of agents in the largest of these scenes. Excess columns of smaller scenes are filled as for agents out
    of sight.

    Attributes:
        s: arc length of the agent's projection onto the path [m]; -inf out of sight.
        d: offset of the agent from the path, to the left [m]; inf out of sight.
        gap: from the vehicle's front bumper to the agent's rear, along the path [m]; negative alongside.
        speed: of the agent along the path [m/s].
        ahead: whether the agent's centre is ahead of the vehicle's.
        aside: lateral gap between agent and vehicle when they pass [m]; negative in the strip swept by the vehicle.
        in_path: whether the agent's box overlaps that strip, widened by the margin.
        first: one number or (m,): row of the first agent of the vehicle's scene in the table.
        own_s, own_d: one number or (m,): `s` and `d` of the vehicle itself [m].
    """

    s: Floats2
    d: Floats2
    gap: Floats2
    speed: Floats2
    ahead: Bools2
    aside: Floats2
    in_path: Bools2
    first: Ints
    own_s: Floats
    own_d: Floats

    def pairs(self, which: BoolArray) -> Iterator[tuple[int, int, int]]:
        """Position of the vehicle, column, and row of the agent in the table, for each True in `which` (m, w)."""
        vehicle, column = which.nonzero()
        return zip(vehicle.tolist(), column.tolist(), (self.first[vehicle] + column).tolist(), strict=True)


class ProjectedPairs(NamedTuple):
    """k pairs of a vehicle and an agent within its sight, ordered by the vehicle.

    Attributes:
        pair: (2, k) position of the vehicle among m, and row of the agent.
        s, d: (k,) arc length and offset of the agent on the vehicle's path [m].
        turn: (k,) heading of the agent relative to the path [rad].
    """

    pair: Ints2
    s: Floats
    d: Floats
    turn: Floats


def along_paths(
    paths: PathBatch,
    agents: AgentTable,
    rows: IntArray,
    margin: float = MARGIN,
    sight: float | FloatArray = SIGHT,
    poses: Poses | None = None,
    path: IntArray | None = None,
) -> AlongPath:
    """Returns agents relative to those in `rows` (m,), each along a path of its own; no vehicle is ahead of itself.

    `margin` [m] is kept to their boxes, and they are seen up to `sight`, (m,) or one for all, at most SIGHT [m].
    None stands for actual poses, and for one path per vehicle, in order; else `path` (m,) are positions in `paths`.
    Arrays are (m, w).
    """
    reach = np.minimum(sight, SIGHT) if isinstance(sight, np.ndarray) else np.full(len(rows), min(sight, SIGHT))
    own = PoseArrays(*(poses or (agents.x[rows], agents.y[rows], agents.yaw[rows])))
    first, most, pairs = _pairs(paths, agents, rows, own, reach, paths.each if path is None else path, np.inf)
    (ahead, in_path), where, (own_s, own_d) = _along(pairs, agents.arrays, rows, first, most, margin)
    s, d, gap, speed, aside = where
    return AlongPath(s, d, gap, speed, ahead, aside, in_path, first, own_s, own_d)


def ahead_in_path(
    paths: PathBatch, agents: AgentTable, rows: IntArray, poses: Poses
) -> tuple[Leaders, FloatArray, FloatArray]:
    """Returns the agents ahead in the paths of those in `rows` (m,), as :func:`along_paths` finds them by default.

    It takes a fraction of the time, since most agents around are beside the paths. Gaps to others than leaders, and
    their speeds, are undefined. Then come `own_s` and `own_d` (m,) of :class:`AlongPath`.
    """
    own, reach = PoseArrays(*poses), np.full(len(rows), SIGHT)
    first, most, pairs = _pairs(paths, agents, rows, own, reach, paths.each, MARGIN)
    gap, speed, leads, (own_s, own_d) = _leading(pairs, agents.arrays, rows, first, most, MARGIN)
    return Leaders(gap, speed, leads, first, agents.acceleration), own_s, own_d


def _pairs(
    paths: PathBatch,
    agents: AgentTable,
    rows: IntArray,
    own: PoseArrays,
    sight: FloatArray,
    path: IntArray,
    margin: float,
) -> tuple[IntArray, int, ProjectedPairs]:
    """Returns what :func:`_projected` does; the pairs have the headings of agents relative to the paths."""
    first, most, pair, on_path = _projected(agents.arrays, rows, own, sight, path, paths, margin)
    s, d, turn, unit_x, unit_y = on_path
    return first, most, ProjectedPairs(pair, s, d, turn - np.arctan2(unit_y, unit_x))


class Corridor(NamedTuple):
    """A straight strip that contains a path, except for the prolongations of its first and last segment.

    Attributes:
        x, y: of a point on the line along the strip [m].
        cos, sin: of the direction of the line.
        right, left: offsets of the edges of the strip from the line [m].
        turn: cosine of the largest turn between two segments of the path.
        bend: sine of the largest angle between a segment and the line, at most 1.
    """

    x: float
    y: float
    cos: float
    sin: float
    right: float
    left: float
    turn: float
    bend: float


@kernel
def corridor_of(vertices: Floats2, n: int) -> Corridor:
    """Return the corridor of a path (L, 5) of `n` vertices; that of a single one excludes nothing."""
    x, y = vertices[0, X], vertices[0, Y]
    dx, dy = vertices[n - 1, X] - x, vertices[n - 1, Y] - y
    length = math.hypot(dx, dy)
    cos, sin = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
    right, left, turn, bend = 0.0, 0.0, 1.0 if n > 1 else 0.0, 0.0
    for k in range(n - 1):
        unit_x, unit_y = vertices[k, UNIT_X], vertices[k, UNIT_Y]
        offset = cos * (vertices[k + 1, Y] - y) - sin * (vertices[k + 1, X] - x)
        right, left = min(right, offset), max(left, offset)
        bend = max(bend, abs(cos * unit_y - sin * unit_x) if cos * unit_x + sin * unit_y > 0.0 else 1.0)
        if k < n - 2:
            turn = min(turn, unit_x * vertices[k + 1, UNIT_X] + unit_y * vertices[k + 1, UNIT_Y])
    return Corridor(x, y, cos, sin, right, left, turn, bend)


@kernel
def most_turned(corridor: Corridor, cos: float, sin: float) -> float:
    """Return a bound on the sine of the angle between a heading (`cos`, `sin`) and any segment of a path."""
    return min(abs(corridor.cos * sin - corridor.sin * cos) + corridor.bend, 1.0)


@kernel
def is_beyond(corridor: Corridor, vertices: Floats2, n: int, x: float, y: float, aside: float) -> bool:
    """Whether a position is certain to be more than `aside` [m] to a side of a path (L, 5) of `n` vertices.

    Its offset is that from the line of the nearest segment: at a vertex less than its distance, by the turn at most.
    """
    if not corridor.turn > 0.0:
        return False
    distance = (aside + SLACK) / corridor.turn
    offset = corridor.cos * (y - corridor.y) - corridor.sin * (x - corridor.x)
    if not max(offset - corridor.left, corridor.right - offset) > distance:
        return False
    nearest = nearest_of(vertices, n, 0, 1, x, y, (0, math.inf, 0.0, 0.0))
    nearest = nearest_of(vertices, n, n - 2, n - 1, x, y, nearest)
    return nearest[1] > distance * distance


@kernel
def _projected(
    agents: AgentArrays, rows: Ints, own: PoseArrays, sight: Floats, path: Ints, paths: PathBatch, margin: float
) -> tuple[Ints, int, Ints2, Floats2]:
    """Pairs of vehicles and agents within sight of each other, and the agents' positions along the vehicles' paths.

    The vehicles are in `rows` (m,), at poses `own`, and have the paths at positions `path` (m,). Only agents of one
    scene form pairs. Agents that are certain not to be in the path, widened by `margin` [m], are left out; infinite
    for none.

    Returns the first row (m,) of each vehicle's scene, and the number of agents in the largest of these; k pairs,
    ordered by the vehicle: (2, k) position of the vehicle in `rows`, and row of the agent; (5, k) arc length and
    offset of the agent on the path [m], its heading [rad], and x and y of the path's direction there.
    """
    begin, end = within_scenes(agents.scene, rows)
    most, pairs = 0, 0
    for i in range(len(rows)):
        most, pairs = max(most, end[i] - begin[i]), pairs + end[i] - begin[i]
    pair, place = np.empty((2, pairs), np.int64), np.empty((5, pairs))
    cos, sin = np.cos(agents.yaw), np.sin(agents.yaw)
    # the pair for which an agent was projected onto a path already
    before = np.full((len(paths.counts), most), -1, np.int64)
    k = 0
    for i in range(len(rows)):
        p = path[i]
        vertices, last, on_path = paths.segments[p], paths.counts[p] - 2, before[p]
        beside, corridor = margin, corridor_of(vertices, last + 2)
        if beside < np.inf:
            own_d = nearest(paths, p, own.x[i], own.y[i])[2]
            beside += abs(own_d) + 0.5 * agents.width[rows[i]]
        for j in range(begin[i], end[i]):
            dx, dy = agents.x[j] - own.x[i], agents.y[j] - own.y[i]
            if not dx * dx + dy * dy < sight[i] * sight[i]:
                continue
            if beside < np.inf and j != rows[i]:
                across = 0.5 * (agents.length[j] * most_turned(corridor, cos[j], sin[j]) + agents.width[j])
                if is_beyond(corridor, vertices, last + 2, agents.x[j], agents.y[j], beside + across):
                    continue
            pair[0, k], pair[1, k] = i, j
            earlier = on_path[j - begin[i]]
            # not an agent of another scene on the same path
            if j != rows[i] and earlier >= 0 and pair[1, earlier] == j:
                for field in range(5):
                    place[field, k] = place[field, earlier]
                k += 1
                continue
            place_x, place_y, heading = agents.x[j], agents.y[j], agents.yaw[j]
            if j == rows[i]:
                place_x, place_y, heading = own.x[i], own.y[i], own.yaw[i]
            else:
                on_path[j - begin[i]] = k
            segment, s, d = nearest(paths, p, place_x, place_y)
            # at a vertex, the direction is that of the segment that begins there
            if segment < last and s >= vertices[segment + 1, S]:
                segment += 1
            place[0, k], place[1, k], place[2, k] = s, d, heading
            place[3, k], place[4, k] = vertices[segment, UNIT_X], vertices[segment, UNIT_Y]
            k += 1
    return begin, most, pair[:, :k].copy(), place[:, :k].copy()


@kernel
def _own(pairs: ProjectedPairs, rows: Ints) -> Floats2:
    """Return arc lengths and offsets (2, m) of the vehicles in `rows` (m,) on their own paths."""
    own = np.empty((2, len(rows)))
    own[0], own[1] = -np.inf, np.inf
    for k in range(len(pairs.s)):
        i = pairs.pair[0, k]
        if pairs.pair[1, k] == rows[i]:
            own[0, i], own[1, i] = pairs.s[k], pairs.d[k]
    return own


@kernel
def _passed(
    pairs: ProjectedPairs, k: int, agents: AgentArrays, row: int, own_s: float, own_d: float
) -> tuple[float, float, float, float]:
    """Return gap [m] and speed [m/s] of the agent of pair `k`, as in :class:`AlongPath`, and how it is passed.

    The vehicle is in `row`. That is the lateral distance of both centres, and the half extents of both boxes [m].
    """
    j, cos, sin = pairs.pair[1, k], math.cos(pairs.turn[k]), abs(math.sin(pairs.turn[k]))
    half_along = 0.5 * (agents.length[j] * abs(cos) + agents.width[j] * sin)
    half_across = 0.5 * (agents.length[j] * sin + agents.width[j] * abs(cos))
    # the swept strip begins at the vehicle, so that it is offset from the path over the first metres
    offset = own_d * within(1.0 - (pairs.s[k] - own_s) / MERGE, 0.0, 1.0)
    gap = pairs.s[k] - half_along - own_s - 0.5 * agents.length[row]
    return gap, agents.speed[j] * cos, abs(pairs.d[k] - offset), half_across


@kernel
def _leading(
    pairs: ProjectedPairs, agents: AgentArrays, rows: Ints, first: Ints, most: int, margin: float
) -> tuple[Floats2, Floats2, Bools2, Floats2]:
    """Return gap, speed, leads (m, w) of :class:`.Leaders`, and own_s and own_d (2, m); arguments as of `_along`."""
    shape, own = (len(rows), most), _own(pairs, rows)
    gap, speed, leads = np.empty(shape), np.empty(shape), np.zeros(shape, np.bool_)
    for k in range(len(pairs.s)):
        i, j = pairs.pair[0, k], pairs.pair[1, k]
        if j != rows[i] and pairs.s[k] > own[0, i]:
            c, half_width = j - first[i], 0.5 * agents.width[rows[i]]
            gap[i, c], speed[i, c], passing, half_across = _passed(pairs, k, agents, rows[i], own[0, i], own[1, i])
            leads[i, c] = passing < half_across + (half_width + margin)
    return gap, speed, leads, own


@kernel
def _along(
    pairs: ProjectedPairs, agents: AgentArrays, rows: Ints, first: Ints, most: int, margin: float
) -> tuple[Bools3, Floats3, Floats2]:
    """Return the fields of :class:`AlongPath`; arguments as returned by :func:`_projected`.

    These are ahead and in_path (2, m, w); s, d, gap, speed and aside (5, m, w); own_s and own_d (2, m).
    """
    shape, own = (len(rows), most), _own(pairs, rows)
    seen, where = np.zeros((2, *shape), np.bool_), np.empty((5, *shape))
    where[0], where[1], where[2], where[3], where[4] = -np.inf, np.inf, -np.inf, 0.0, np.inf
    for k in range(len(pairs.s)):
        i, j = pairs.pair[0, k], pairs.pair[1, k]
        c, half_width = j - first[i], 0.5 * agents.width[rows[i]]
        gap, speed, passing, half_across = _passed(pairs, k, agents, rows[i], own[0, i], own[1, i])
        where[0, i, c], where[1, i, c], where[2, i, c], where[3, i, c] = pairs.s[k], pairs.d[k], gap, speed
        where[4, i, c] = passing - (half_across + half_width)
        seen[0, i, c] = j != rows[i] and pairs.s[k] > own[0, i]
        seen[1, i, c] = passing < half_across + (half_width + margin)
    return seen, where, own
