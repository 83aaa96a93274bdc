"""Who leads an agent on the way that its log takes: along the recorded positions, and straight on beyond them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from litsim_policy.motion.along_path import MARGIN, MERGE, Corridor, corridor_of, is_beyond, most_turned
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import STEP_S, AgentArrays, IntArray
from litsim_sim.kernels.compiled import Bools2, Floats, Floats2, Ints, OutFloats2, kernel
from litsim_sim.scenario.log import Log

SIGHT = 60.0  # [m] range of leaders
BEHIND = 2.0  # [m] by which the centre of a leader may be behind
SPACING = 0.5  # [m] least length of a segment of the way: recorded positions jitter when vehicles stand
ANTICIPATION = 1.0  # [s] for which others are expected to move on sideways: who is about to enter the way leads
ROUNDING = 1e-6  # [m] by which computed distances may differ from true ones, and more
BACK = 5  # [steps] over which the acceleration of a leader is taken
VERTICES = int(SIGHT / SPACING) + 2
X, Y, S, UNIT_X, UNIT_Y = range(5)  # columns of a way


class LogColumns(NamedTuple):
    """The columns of a :class:`litsim_sim.scenario.log.Log` that kernels read; arrays (n,) and (n, steps).

    Attributes:
        begin, end: first row of the scene of each agent, and the row behind it.
    """

    x: Floats2
    y: Floats2
    yaw: Floats2
    speed: Floats2
    valid: Bools2
    length: Floats
    width: Floats
    first_step: Ints
    last_step: Ints
    begin: Ints
    end: Ints


class Vehicle(NamedTuple):
    """A vehicle, in units and frames of :class:`litsim_sim.core.scene.AgentTable`."""

    x: float
    y: float
    yaw: float
    speed: float
    length: float
    width: float


class Leader(NamedTuple):
    """Who is ahead of a vehicle on its way.

    Attributes:
        row: among the agents; -1 for none.
        gap: from bumper to bumper [m]; infinite for none.
        speed: along the way [m/s].
        acceleration: over the last half second [m/s2].
    """

    row: int
    gap: float
    speed: float
    acceleration: float


def columns_of(log: Log) -> LogColumns:
    """Returns the columns of `log`, or of a batched one."""
    scene: IntArray = getattr(log, "scene", np.zeros(len(log.ids), np.int64))
    begin, end = scene.searchsorted(scene), scene.searchsorted(scene, "right")
    columns = (log.x, log.y, log.yaw, log.speed, log.valid, log.length, log.width, log.first_step, log.last_step)
    return LogColumns(*columns, begin, end)


@kernel
def lay_way(log: LogColumns, row: int, step: int, way: OutFloats2) -> int:
    """Write to `way` (VERTICES, 5) where the log in `row` goes from `step` on; returns the number of vertices.

    Columns are x, y, arc length [m], and the unit vector of the segment that begins there; the last segment is
    prolonged without end.
    """
    x, y = log.x[row, step], log.y[row, step]
    way[0, X], way[0, Y], way[0, S] = x, y, 0.0
    way[0, UNIT_X], way[0, UNIT_Y] = math.cos(log.yaw[row, step]), math.sin(log.yaw[row, step])
    count = 1
    for t in range(step + 1, log.last_step[row] + 1):
        dx, dy = log.x[row, t] - way[count - 1, X], log.y[row, t] - way[count - 1, Y]
        length = math.hypot(dx, dy)
        if length < SPACING:
            continue
        way[count - 1, UNIT_X], way[count - 1, UNIT_Y] = dx / length, dy / length
        way[count, X], way[count, Y], way[count, S] = log.x[row, t], log.y[row, t], way[count - 1, S] + length
        way[count, UNIT_X], way[count, UNIT_Y] = dx / length, dy / length
        count += 1
        if way[count - 1, S] > SIGHT or count == VERTICES:
            break
    return count


@kernel
def place_on(way: Floats2, count: int, x: float, y: float) -> tuple[float, float, float, float]:
    """Returns arc length and offset to the left [m] of a position on a way of `count` vertices, and its direction.

    A way comes nearer by at most its own length: segments that lie too soon behind another to be the nearest are
    passed over. One vertex, about as far along the way as the position is away, bounds the distance of the nearest.
    """
    ahead = int(np.searchsorted(way[1:count, S], math.hypot(x - way[0, X], y - way[0, Y])))
    least = math.hypot(x - way[ahead, X], y - way[ahead, Y]) + ROUNDING
    best, s, d, unit_x, unit_y, passed = np.inf, 0.0, 0.0, 1.0, 0.0, -np.inf
    for k in range(count):
        if k < count - 1 and way[k + 1, S] < passed:
            continue
        dx, dy = x - way[k, X], y - way[k, Y]
        along = dx * way[k, UNIT_X] + dy * way[k, UNIT_Y]
        if k > 0:
            along = max(along, 0.0)
        if k < count - 1:
            along = min(along, way[k + 1, S] - way[k, S])
        off_x, off_y = dx - along * way[k, UNIT_X], dy - along * way[k, UNIT_Y]
        square = off_x * off_x + off_y * off_y
        passed = way[k, S] + along + math.sqrt(square) - least
        if square < best:
            best, s, unit_x, unit_y = square, way[k, S] + along, way[k, UNIT_X], way[k, UNIT_Y]
            d = unit_x * dy - unit_y * dx
    return s, d, unit_x, unit_y


@kernel
def may_lead(dx: float, dy: float, cos: float, sin: float) -> bool:
    """Returns whether one at `dx`, `dy` [m] from a vehicle with the heading (`cos`, `sin`) is ahead and in sight."""
    return dx * dx + dy * dy < SIGHT * SIGHT and dx * cos + dy * sin > -BEHIND


@kernel
def gap_ahead(
    way: Floats2, count: int, corridor: Corridor, own: Vehicle, place: tuple[float, float], other: Vehicle
) -> tuple[float, float]:
    """Returns the gap [m] to a vehicle ahead that is on the way or about to enter it, and its speed along it [m/s].

    The gap is infinite to all others; those far beside the `corridor` of the way are passed over. `place` is the arc
    length of the own vehicle on the way, and its offset [m].
    """
    heading_x, heading_y = math.cos(other.yaw), math.sin(other.yaw)
    turned = most_turned(corridor, heading_x, heading_y)
    beside = 0.5 * (other.length * turned + other.width + own.width) + MARGIN + abs(place[1])
    if is_beyond(corridor, way, count, other.x, other.y, beside + ANTICIPATION * abs(other.speed) * turned):
        return np.inf, 0.0
    s, d, unit_x, unit_y = place_on(way, count, other.x, other.y)
    if s <= place[0]:
        return np.inf, 0.0
    cos, sin = heading_x * unit_x + heading_y * unit_y, heading_y * unit_x - heading_x * unit_y
    half_along = 0.5 * (other.length * abs(cos) + other.width * abs(sin))
    half_across = 0.5 * (other.length * abs(sin) + other.width * abs(cos))
    aside = d - place[1] * within(1.0 - (s - place[0]) / MERGE, 0.0, 1.0)
    aside_soon, clear = aside + ANTICIPATION * other.speed * sin, half_across + 0.5 * own.width + MARGIN
    if min(aside, aside_soon) >= clear or max(aside, aside_soon) <= -clear:
        return np.inf, 0.0
    return s - half_along - place[0] - 0.5 * own.length, other.speed * cos


@kernel
def vehicle_of(agents: AgentArrays, row: int) -> Vehicle:
    """Returns the agent in `row` of a step."""
    x, y, yaw, speed = agents.x[row], agents.y[row], agents.yaw[row], agents.speed[row]
    return Vehicle(x, y, yaw, speed, agents.length[row], agents.width[row])


@kernel
def logged_vehicle(log: LogColumns, row: int, step: int) -> Vehicle:
    """Returns the agent in `row` of the log, at `step`."""
    x, y, yaw, speed = log.x[row, step], log.y[row, step], log.yaw[row, step], log.speed[row, step]
    return Vehicle(x, y, yaw, speed, log.length[row], log.width[row])


@kernel
def leader_now(way: Floats2, count: int, agents: AgentArrays, row: int, others: Ints) -> Leader:
    """Returns the leader of the agent in `row` on its way, of those in the rows `others` of its scene.

    The acceleration is that of the step.
    """
    own, leader = vehicle_of(agents, row), Leader(-1, np.inf, 0.0, 0.0)
    (s, d, _, _), corridor = place_on(way, count, own.x, own.y), corridor_of(way, count)
    cos, sin = math.cos(own.yaw), math.sin(own.yaw)
    for j in others:
        if j != row and may_lead(agents.x[j] - own.x, agents.y[j] - own.y, cos, sin):
            gap, speed = gap_ahead(way, count, corridor, own, (s, d), vehicle_of(agents, j))
            if gap < leader.gap:
                leader = Leader(j, gap, speed, agents.acceleration[j])
    return leader


@kernel
def logged_leader(way: Floats2, count: int, log: LogColumns, row: int, step: int) -> Leader:
    """Returns the leader of the agent in `row` of the log in the recorded scene of `step`, where its way begins."""
    own, leader, corridor = logged_vehicle(log, row, step), Leader(-1, np.inf, 0.0, 0.0), corridor_of(way, count)
    cos, sin = math.cos(own.yaw), math.sin(own.yaw)
    for j in range(log.begin[row], log.end[row]):
        if j != row and log.valid[j, step] and may_lead(log.x[j, step] - own.x, log.y[j, step] - own.y, cos, sin):
            gap, speed = gap_ahead(way, count, corridor, own, (0.0, 0.0), logged_vehicle(log, j, step))
            if gap < leader.gap:
                before = max(step - BACK, log.first_step[j])
                change = log.speed[j, step] - log.speed[j, before]
                leader = Leader(j, gap, speed, change / (max(step - before, 1) * STEP_S))
    return leader
