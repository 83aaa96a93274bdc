"""Surrogate safety measures by step: time to collision, headway, and deceleration rate to avoid a crash."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.compiled import FLOATS, INTS, OUT_FLOATS, OUT_INTS, kernel
from litsim_sim.core.geometry import to_body
from litsim_sim.core.pair_geometry import overlap, within_scenes
from litsim_sim.core.scene import AgentTable, FloatArray, IntArray
from litsim_sim.core.steps import Steps

TTC_HORIZON_S = 3.0  # nuPlan
TTC_STEP_S = 0.1
TTC_CRITICAL_S = (0.95, 1.5)  # nuPlan, and the common value of the literature
SIGHT_M = 100.0  # gap beyond which a vehicle is not a leader


@dataclass(frozen=True)
class Following:
    """How agents follow their leaders; arrays of one shape.

    Leaders are defined by the caller: :func:`following` takes the strip that the own box sweeps straight ahead, for m
    agents at one step; :func:`litsim_sim.mining.leaders.leaders` takes lanes, for all agents at all steps.

    Attributes:
        leader: row of the leader in the table, -1 for none.
        gap: bumper-to-bumper distance along the own heading [m]; 0 in contact, inf without leader.
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
        """Derive the measures from the own `speed` [m/s] and the attributes of the same names."""
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
    """The measures of `agent` over the steps `tables`."""
    steps = Steps.of(tables)
    rows, table = steps.track(agent), steps.stacked
    behind, step = following(table, rows), steps.step[table.number[rows]]
    return SafetySeries(agent, step, times_to_collision(table, rows), behind.headway, behind.drac)


def shortest_own_ttc(tables: Sequence[AgentTable], agent: int, touched: Mapping[int, int]) -> float:
    """Shortest time to collision [s] of `agent` with agents that it has not touched; inf if none within 3 s.

    An agent counts until the first contact with it, as in nuPlan's measure: what follows is not a new approach.

    Args:
        tables: steps.
        agent: its id.
        touched: step of the first contact, by id of the other agent.
    """
    shortest = np.inf
    for table in tables:
        gone = [other for other, step in touched.items() if step <= table.step]
        others = table.take(~np.isin(table.id, gone)) if gone else table
        rows = np.flatnonzero(others.id == agent)
        if len(rows):
            shortest = min(shortest, float(times_to_collision(others, rows)[0]))
    return shortest


def times_to_collision(table: AgentTable, rows: IntArray) -> FloatArray:
    """Time (m,) [s] until the boxes in `rows` (m,) first overlap another, at constant velocities; inf beyond 3 s.

    0 in contact. Agents behind count only while in contact, as in nuPlan's measure. Scenes are independent.
    """
    boxes = table.x, table.y, table.yaw, table.length, table.width
    velocity = table.speed * np.cos(table.yaw), table.speed * np.sin(table.yaw)
    return _first_meetings(table.scene, rows.astype(np.int64), *boxes, *velocity)


@kernel(OUT_FLOATS(INTS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS))
def _first_meetings(  # noqa: PLR0917 - a kernel takes arrays and numbers
    scene: IntArray,
    rows: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    length: FloatArray,
    width: FloatArray,
    speed_x: FloatArray,
    speed_y: FloatArray,
) -> FloatArray:
    """See :func:`times_to_collision`; all arrays but `rows` (m,) are of all boxes (n,)."""
    found, (begin, end) = np.full(len(rows), math.inf), within_scenes(scene, rows)
    steps = round(TTC_HORIZON_S / TTC_STEP_S)
    for m in range(len(rows)):
        a = rows[m]
        half, cos, sin = 0.5 * math.hypot(length[a], width[a]), math.cos(yaw[a]), math.sin(yaw[a])
        for b in range(begin[m], end[m]):
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


def following(table: AgentTable, rows: IntArray) -> Following:
    """How the agents in `rows` (m,) of `table` follow their leaders; arrays (m,).

    The leader is the nearest agent within :data:`SIGHT_M` whose box reaches into the strip that the own box sweeps
    straight ahead.
    """
    begin, end = within_scenes(table.scene, np.asarray(rows, np.int64))
    first = np.cumsum(end - begin) - (end - begin)  # index of each agent's first pair with its scene
    own = np.repeat(rows, end - begin)
    other = np.arange(len(own)) - np.repeat(first - begin, end - begin)
    own_yaw = table.yaw[own]
    ahead, left = to_body(table.x[other] - table.x[own], table.y[other] - table.y[own], own_yaw)
    cos, sin = np.cos(table.yaw[other] - own_yaw), np.sin(table.yaw[other] - own_yaw)
    length, width = table.length[other], table.width[other]
    along = 0.5 * (length * np.abs(cos) + width * np.abs(sin))
    across = 0.5 * (length * np.abs(sin) + width * np.abs(cos))
    gaps = ahead - along - 0.5 * table.length[own]
    leads = (ahead > 0.0) & (gaps < SIGHT_M) & (np.abs(left) < across + 0.5 * table.width[own]) & (other != own)
    gaps = np.where(leads, gaps, np.inf)
    nearest = _least(gaps, first, end - begin)
    there, leader = leads[nearest], other[nearest]
    gap, speed = np.maximum(gaps[nearest], 0.0), table.speed[rows]
    closing = np.where(there, speed - table.speed[leader] * cos[nearest], 0.0)
    return Following.measured(np.where(there, leader, -1), gap, closing, speed)


@kernel(OUT_INTS(FLOATS, INTS, INTS))
def _least(values: FloatArray, first: IntArray, count: IntArray) -> IntArray:
    """Index (m,) of the smallest of `values` in each of m ranges, the first of equal ones; `first`, `count` (m,)."""
    found = first.copy()
    for m in range(len(first)):
        for k in range(first[m], first[m] + count[m]):
            if values[k] < values[found[m]]:
                found[m] = k
    return found
