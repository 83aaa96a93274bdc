"""Surrogate safety measures by step: time to collision, headway, and deceleration rate to avoid a crash."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.nearby import Sorted, sorted_by_place, within_reach
from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import AgentRows, AgentTable, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.kernels.compiled import Floats, Ints, kernel

TTC_HORIZON_S = 3.0  # nuPlan
TTC_STEP_S = 0.1
TTC_CRITICAL_S = (0.95, 1.5)  # nuPlan, and the common value of the literature
ROUNDING_M = 1e-6  # by which bounds on distances are widened
SIGHT_M = 100.0  # gap beyond which a vehicle is not a leader
CORNERS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])  # of a box, in lengths and widths


@dataclass(frozen=True)
class Following:
    """How agents follow their leaders; arrays of one shape.

    Leaders are defined by the caller: :func:`following` takes the strip that the own box sweeps straight ahead, for m
    agents at one step; :func:`litsim_data.mining.leaders.leaders` takes lanes, for all agents at all steps.

    Attributes:
        leader: row of the leader in the table, -1 for none.
        gap: distance from the own front to the leader along the own heading or the lane [m]; 0 in contact, inf without
            leader.
        closing: own speed minus the leader's, along the own heading or the lane [m/s]; 0 without leader.
        headway: gap over own speed [s]; inf without leader or at rest.
        drac: deceleration rate to avoid a crash, closing^2 / (2 gap) [m/s2] (Almqvist 1991); 0 where the gap does not
            close, inf in contact.
    """

    leader: IntArray
    gap: FloatArray
    closing: FloatArray
    headway: FloatArray
    drac: FloatArray

    @classmethod
    def measured(cls, leader: IntArray, gap: FloatArray, closing: FloatArray, speed: FloatArray) -> Following:
        """Derives the measures from the own `speed` [m/s] and the attributes of the same names."""
        there = leader >= 0
        headway = np.divide(gap, speed, out=np.full(gap.shape, np.inf), where=there & (speed > 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            drac = np.where(closing > 0.0, closing**2 / (2.0 * gap), 0.0)
        return cls(leader, gap, closing, headway, drac)

    @property
    def time_to_leader(self) -> FloatArray:
        """Gap over closing speed [s]; inf where the gap does not close."""
        return np.divide(self.gap, self.closing, out=np.full(self.gap.shape, np.inf), where=self.closing > 0.0)


@dataclass(frozen=True)
class SafetySeries:
    """Measures of one agent over the steps at which it is on the road; arrays (n,).

    Attributes:
        agent: its id.
        step: steps.
        ttc: see :func:`times_to_collision` [s].
        headway, drac: see :class:`Following` [s], [m/s2].
    """

    agent: int
    step: IntArray
    ttc: FloatArray
    headway: FloatArray
    drac: FloatArray


def safety_series(tables: Sequence[AgentTable], agent: int) -> SafetySeries:
    """Returns the measures of `agent` over the steps `tables`."""
    steps, series = Steps.of(tables), [(np.empty(0, np.int64), *np.empty((3, 0)))]
    for part in steps.parts():
        rows, table = part.track(agent), part.stacked
        behind, step = following(table, rows), part.step[table.number[rows]]
        series.append((step, times_to_collision(table, rows), behind.headway, behind.drac))
    return SafetySeries(agent, *(np.concatenate(values) for values in zip(*series, strict=True)))


def shortest_own_ttc(tables: Sequence[AgentTable], agent: int, touched: Mapping[int, int]) -> float:
    """Returns the shortest time to collision [s] of `agent` with agents that it has not touched; inf beyond 3 s.

    An agent counts until the first contact with it, as in nuPlan's measure: what follows is not a new approach. Steps
    of these are `touched`, by id.
    """
    shortest = np.inf
    for table in tables:
        gone = [other for other, step in touched.items() if step <= table.step]
        others = table.take(~np.isin(table.id, gone)) if gone else table
        rows = np.flatnonzero(others.id == agent)
        if len(rows):
            shortest = min(shortest, float(times_to_collision(others, rows)[0]))
    return shortest


def times_to_collision(table: AgentRows, rows: IntArray) -> FloatArray:
    """Returns times (m,) [s] until boxes in `rows` (m,) overlap another, at constant velocities; inf beyond 3 s.

    0 in contact. Agents behind count only while in contact, as in nuPlan's measure. Scenes are independent.
    """
    rows = rows.astype(np.int64)
    boxes = table.x, table.y, table.yaw, table.length, table.width
    velocity = table.speed * np.cos(table.yaw), table.speed * np.sin(table.yaw)
    return _first_meetings(sorted_by_place(table, rows), rows, *boxes, *velocity)


@kernel
def _largest(x: Floats, y: Floats) -> float:
    """Returns the length of the longest of the vectors `x`, `y` (n,), but for those that are NaN; 0 without any."""
    largest = 0.0
    for k in range(len(x)):
        length = math.hypot(x[k], y[k])
        if length > largest:  # noqa: PLR1730 - max would return NaN
            largest = length
    return largest


@kernel
def _first_meetings(  # noqa: PLR0917 - a kernel takes arrays and numbers
    agents: Sorted,
    rows: Ints,
    x: Floats,
    y: Floats,
    yaw: Floats,
    length: Floats,
    width: Floats,
    speed_x: Floats,
    speed_y: Floats,
) -> Floats:
    """See :func:`times_to_collision`; all arrays but `rows` (m,) are of all boxes (n,)."""
    found = np.full(len(rows), math.inf)
    steps = round(TTC_HORIZON_S / TTC_STEP_S)
    farthest = 0.5 * _largest(length, width) + _largest(speed_x, speed_y) * TTC_HORIZON_S + ROUNDING_M
    for m in range(len(rows)):
        a = rows[m]
        half, cos, sin = 0.5 * math.hypot(length[a], width[a]), math.cos(yaw[a]), math.sin(yaw[a])
        own_way = math.hypot(speed_x[a], speed_y[a]) * TTC_HORIZON_S
        begin, end = within_reach(agents, m, a, half + own_way + farthest)
        for b in agents.order[begin:end]:
            dx, dy = x[b] - x[a], y[b] - y[a]
            fast_x, fast_y = speed_x[b] - speed_x[a], speed_y[b] - speed_y[a]
            reach = 0.5 * math.hypot(length[b], width[b]) + half + math.hypot(fast_x, fast_y) * TTC_HORIZON_S
            if b == a or not math.hypot(dx, dy) <= reach:
                continue
            last = steps if dx * cos + dy * sin > 0.0 else 0
            for k in range(last + 1):
                t = k * TTC_STEP_S
                if t >= found[m]:
                    break
                if overlap(dx + t * fast_x, dy + t * fast_y, yaw[a], yaw[b], length[a], width[a], length[b], width[b]):
                    found[m] = t
                    break
    return found


def following(table: AgentRows, rows: IntArray) -> Following:
    """Returns how the agents in `rows` (m,) of `table` follow their leaders; arrays (m,). Scenes are independent.

    The leader is the agent within :data:`SIGHT_M` whose box is the first that the strip meets which the own box sweeps
    straight ahead; the gap is the distance to where they meet.
    """
    rows = rows.astype(np.int64)
    boxes = table.x, table.y, table.yaw, table.length, table.width
    leader, gap = _leaders(sorted_by_place(table, rows), rows, *boxes)
    there, speed = leader >= 0, table.speed[rows]
    along = table.speed[leader] * np.cos(table.yaw[leader] - table.yaw[rows])
    return Following.measured(leader, gap, np.where(there, speed - along, 0.0), speed)


@kernel
def _rear(ahead: float, left: float, yaw: float, length: float, width: float, half: float, back: float) -> float:
    """Smallest distance ahead [m] of a box within the strip up to `half` [m] to either side; inf if it is outside.

    inf, too, if it is in the strip only more than `back` [m] behind, as the tail of a vehicle that turns away beside.

    Args:
        ahead, left: centre of the box [m].
        yaw: heading [rad].
        length, width: extents [m].
        half: half width of the strip [m].
        back: distance of the own rear behind the own centre [m].
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    if not abs(left) < half + 0.5 * (length * abs(sin) + width * abs(cos)):
        return math.inf
    rear, front = math.inf, -math.inf
    for k in range(4):  # edges, each from a corner to the next one
        u0, v0, u1, v1 = (
            CORNERS[k, 0] * length,
            CORNERS[k, 1] * width,
            CORNERS[k - 1, 0] * length,
            CORNERS[k - 1, 1] * width,
        )
        x0, y0 = ahead + u0 * cos - v0 * sin, left + u0 * sin + v0 * cos
        x1, y1 = ahead + u1 * cos - v1 * sin, left + u1 * sin + v1 * cos
        if abs(y0) <= half:
            rear, front = min(rear, x0), max(front, x0)
        for side in (-half, half):
            if (y0 - side) * (y1 - side) < 0.0:
                x = x0 + (side - y0) / (y1 - y0) * (x1 - x0)
                rear, front = min(rear, x), max(front, x)
    return rear if front > -back else math.inf


@kernel
def _leaders(
    agents: Sorted, rows: Ints, x: Floats, y: Floats, yaw: Floats, length: Floats, width: Floats
) -> tuple[Ints, Floats]:
    """Leader (m,) and gap (m,) of :class:`Following`; all arrays but `rows` (m,) are of all boxes (n,)."""
    leader, gap = np.full(len(rows), -1, np.int64), np.full(len(rows), math.inf)
    farthest = SIGHT_M + _largest(length, width) + ROUNDING_M
    for m in range(len(rows)):
        a = rows[m]
        cos, sin, front, half = math.cos(yaw[a]), math.sin(yaw[a]), 0.5 * length[a], 0.5 * width[a]
        nearest = SIGHT_M + front
        begin, end = within_reach(agents, m, a, farthest + front + half)
        for b in agents.order[begin:end]:
            dx, dy, reach = x[b] - x[a], y[b] - y[a], 0.5 * math.hypot(length[b], width[b])
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            if b == a or not (0.0 < ahead <= nearest + reach and abs(left) < half + reach):
                continue
            rear = _rear(ahead, left, yaw[b] - yaw[a], length[b], width[b], half, front)
            if rear < nearest or (rear == nearest and b < leader[m]):  # in any order, the same one
                nearest, leader[m], gap[m] = rear, b, max(rear - front, 0.0)
    return leader, gap
