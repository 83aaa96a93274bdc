"""Surrogate safety measures of single steps: time to collision, headway, deceleration to avoid a crash."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.compiled import FLOATS, INTS, OUT_FLOATS, kernel
from litsim_sim.core.geometry import to_body
from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import AgentTable, FloatArray, IntArray

TTC_HORIZON_S = 3.0  # nuPlan
TTC_STEP_S = 0.1
TTC_CRITICAL_S = (0.95, 1.5)  # nuPlan, and the common value of the literature
SIGHT_M = 100.0  # ahead, for the leader


@dataclass(frozen=True)
class Following:
    """How agents follow their leaders; arrays of one shape.

    Whoever makes one says who the leader is: :func:`following`, of m agents at one step, by the strip that their boxes
    sweep straight on; :func:`litsim_sim.mining.leaders.leaders`, of all agents at all steps, by lanes.

    Attributes:
        leader: row of the leader in the table, -1 where there is none.
        gap: from bumper to bumper along the own heading [m]; 0 in contact, inf without leader.
        closing: own speed minus the leader's, along the own heading or along lanes [m/s]; 0 without leader.
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
        """The measures of agents that drive `speed` [m/s]; `leader`, `gap` and `closing` as in the attributes."""
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
        agent: whose.
        step: steps.
        ttc: as :func:`times_to_collision` [s].
        headway, drac: as in :class:`Following` [s], [m/s2].
    """

    agent: int
    step: IntArray
    ttc: FloatArray
    headway: FloatArray
    drac: FloatArray


def safety_series(tables: Sequence[AgentTable], agent: int) -> SafetySeries:
    """The measures of `agent` at each of the steps `tables` at which it is on the road."""
    steps, values = [], []
    for table in tables:
        rows = np.flatnonzero(table.id == agent)
        if len(rows):
            behind = following(table, rows)
            steps.append(table.step)
            values.append((times_to_collision(table, rows)[0], behind.headway[0], behind.drac[0]))
    columns = np.array(values).reshape(-1, 3)
    return SafetySeries(agent, np.array(steps, np.int64), columns[:, 0], columns[:, 1], columns[:, 2])


def shortest_own_ttc(tables: Sequence[AgentTable], agent: int, touched: Mapping[int, int]) -> float:
    """Shortest time to collision [s] of `agent` with those that it has not touched; inf where there is none within 3 s.

    Whoever it touches counts until then, as in nuPlan's measure: what follows from a contact is no approach of its own.

    Args:
        tables: steps.
        agent: whose.
        touched: step of the first contact by the id of the other agent.
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
    """Time [s] until the boxes in `rows` (m,) first meet another, all at constant speed and heading; inf beyond 3 s.

    0 in contact. What is behind counts only while it is in contact, as in nuPlan's measure: being run into is not the
    agent's.
    """
    boxes = table.x, table.y, table.yaw, table.length, table.width
    velocity = table.speed * np.cos(table.yaw), table.speed * np.sin(table.yaw)
    return _first_meetings(rows.astype(np.int64), *boxes, *velocity)


@kernel(OUT_FLOATS(INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS))
def _first_meetings(
    rows: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    length: FloatArray,
    width: FloatArray,
    speed_x: FloatArray,
    speed_y: FloatArray,
) -> FloatArray:
    """:func:`times_to_collision` (m,) of the boxes in `rows` (m,) among all (n,), whose velocities are given, too."""
    found = np.full(len(rows), math.inf)
    steps = round(TTC_HORIZON_S / TTC_STEP_S)
    for m in range(len(rows)):
        a = rows[m]
        half, cos, sin = 0.5 * math.hypot(length[a], width[a]), math.cos(yaw[a]), math.sin(yaw[a])
        for b in range(len(x)):
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
    """The leaders of the agents in `rows` (m,) of `table`, and how they are followed; arrays (m,).

    A leader is the nearest agent less than :data:`SIGHT_M` ahead whose box reaches into the strip that the own box
    sweeps straight on.
    """
    each, own_yaw = np.arange(len(rows)), table.yaw[rows, None]
    ahead, left = to_body(table.x - table.x[rows, None], table.y - table.y[rows, None], own_yaw)
    cos, sin = np.cos(table.yaw - own_yaw), np.sin(table.yaw - own_yaw)
    along = 0.5 * (table.length * np.abs(cos) + table.width * np.abs(sin))
    across = 0.5 * (table.length * np.abs(sin) + table.width * np.abs(cos))
    gaps = ahead - along - 0.5 * table.length[rows, None]
    leads = (ahead > 0.0) & (gaps < SIGHT_M) & (np.abs(left) < across + 0.5 * table.width[rows, None])
    leads[each, rows] = False
    gaps = np.where(leads, gaps, np.inf)
    there = leads.any(axis=1)
    nearest = np.argmin(gaps, axis=1) if len(rows) else rows
    gap, speed = np.maximum(gaps[each, nearest], 0.0), table.speed[rows]
    closing = np.where(there, speed - table.speed[nearest] * cos[each, nearest], 0.0)
    return Following.measured(np.where(there, nearest, -1), gap, closing, speed)
