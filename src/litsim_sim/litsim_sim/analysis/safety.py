"""Surrogate safety measures per step: time to collision, headway, deceleration to avoid, post-encroachment time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.geometry import boxes_overlap, to_body
from litsim_sim.recording import STEP_S
from litsim_sim.scene import AgentTable, BoolArray, FloatArray, IntArray

TTC_HORIZON_S = 3.0  # nuPlan
TTC_STEP_S = 0.1
TTC_CRITICAL_S = (0.95, 1.5)  # nuPlan, and the common value of the literature
SIGHT_M = 100.0  # ahead, for the leader
PET_HORIZON_S = 5.0  # between leaving and entering; longer is no encounter


@dataclass(frozen=True)
class SafetySeries:
    """Measures of one agent over the steps at which it is on the road; arrays (n,).

    Attributes:
        agent: whose.
        step: steps.
        ttc: time until its box meets another if all keep speed and heading [s]; inf beyond the horizon of 3 s, 0 in
            contact.
        headway: time headway to the leader, bumper to bumper over own speed [s]; inf without leader or at rest.
        drac: constant braking that keeps it off the leader [m/s2]; 0 where it does not close in, inf in contact.
    """

    agent: int
    step: IntArray
    ttc: FloatArray
    headway: FloatArray
    drac: FloatArray


def safety_series(tables: Sequence[AgentTable], agent: int) -> SafetySeries:
    """Measures of `agent` over `tables`."""
    steps, values = [], []
    for table in tables:
        row = table.row(agent)
        if row >= 0:
            steps.append(table.step)
            values.append((time_to_collision(table, row), *following(table, row)))
    columns = np.array(values).reshape(-1, 3)
    return SafetySeries(agent, np.array(steps, np.int64), columns[:, 0], columns[:, 1], columns[:, 2])


def time_to_collision(table: AgentTable, row: int) -> float:
    """Time [s] until the box in `row` first meets another, all at constant speed and heading; inf beyond 3 s.

    What is behind counts only while it is in contact, as in nuPlan's measure: being run into is not the agent's.
    """
    dx, dy = table.x - table.x[row], table.y - table.y[row]
    ahead, _ = to_body(dx, dy, np.full(len(table), table.yaw[row]))
    speed_x, speed_y = table.speed * np.cos(table.yaw), table.speed * np.sin(table.yaw)
    reach = 0.5 * (np.hypot(table.length, table.width) + np.hypot(table.length[row], table.width[row]))
    closing = np.hypot(speed_x - speed_x[row], speed_y - speed_y[row])
    near = np.hypot(dx, dy) <= reach + closing * TTC_HORIZON_S
    near[row] = False
    if not near.any():
        return float("inf")
    times = np.arange(0.0, TTC_HORIZON_S + 0.5 * TTC_STEP_S, TTC_STEP_S)[:, None]
    hit = boxes_overlap(
        dx[near] + times * (speed_x[near] - speed_x[row]),
        dy[near] + times * (speed_y[near] - speed_y[row]),
        np.broadcast_to(table.yaw[row], near.sum()),
        table.yaw[near],
        (table.length[row], table.width[row]),
        (table.length[near], table.width[near]),
    )
    hit &= (ahead[near] > 0.0) | (times == 0.0)
    any_at = hit.any(axis=1)
    return float(times[np.argmax(any_at), 0]) if any_at.any() else float("inf")


def following(table: AgentTable, row: int) -> tuple[float, float]:
    """Time headway [s] and deceleration rate to avoid a crash [m/s2] behind the leader straight ahead.

    The leader is the nearest agent within 100 m whose box reaches into the strip that the own box sweeps straight on.
    DRAC is (v - v_leader)^2 / (2 gap) (Almqvist 1991).
    """
    heading = np.full(len(table), table.yaw[row])
    ahead, left = to_body(table.x - table.x[row], table.y - table.y[row], heading)
    turn = table.yaw - heading
    along = 0.5 * (table.length * np.abs(np.cos(turn)) + table.width * np.abs(np.sin(turn)))
    across = 0.5 * (table.length * np.abs(np.sin(turn)) + table.width * np.abs(np.cos(turn)))
    gap = ahead - along - 0.5 * table.length[row]
    leads = (ahead > 0.0) & (gap < SIGHT_M) & (np.abs(left) < across + 0.5 * table.width[row])
    leads[row] = False
    if not leads.any():
        return float("inf"), 0.0
    leader = int(np.flatnonzero(leads)[np.argmin(gap[leads])])
    distance, speed = max(0.0, float(gap[leader])), float(table.speed[row])
    closing = speed - float(table.speed[leader] * np.cos(turn[leader]))
    headway = distance / speed if speed > 0.0 else float("inf")
    if closing <= 0.0:
        return headway, 0.0
    return headway, closing**2 / (2.0 * distance) if distance > 0.0 else float("inf")


@dataclass(frozen=True)
class Encroachment:
    """Two agents that use the same place one after the other, in crossing or merging.

    Attributes:
        agent: the other one.
        pet: time between the first leaving and the second entering a place that both sweep, the shortest [s].
        first: id of the one that was there first.
        step: at which the second entered.
    """

    agent: int
    pet: float
    first: int
    step: int


def encroachments(tables: Sequence[AgentTable], agent: int) -> list[Encroachment]:
    """Post-encroachment times of `agent` with every other that comes within 5 s, shortest first (Allen 1978).

    Times between boxes that overlap in space at different steps, to the resolution of a step. Whoever follows in the
    same lane encroaches too: its time is the headway to the leader's rear.
    """
    own_step, own = _track(tables, agent)
    found = []
    others = {int(i) for table in tables if table.row(agent) >= 0 for i in table.id.tolist()} - {agent}
    for other in sorted(others):
        other_step, track = _track(tables, other)
        entry = _shortest(own_step, own, other_step, track)
        if entry is not None:
            i, j, gap = entry
            first, step = (agent, other_step[j]) if own_step[i] < other_step[j] else (other, own_step[i])
            found.append(Encroachment(other, gap * STEP_S, first, int(step)))
    return sorted(found, key=lambda e: (e.pet, e.agent))


def _track(tables: Sequence[AgentTable], agent: int) -> tuple[IntArray, FloatArray]:
    """Steps (n,) and boxes (n, 5) x, y, yaw, length, width of an agent."""
    rows = [(table, table.row(agent)) for table in tables]
    there = [(table, row) for table, row in rows if row >= 0]
    boxes = [[getattr(t, f)[row] for f in ("x", "y", "yaw", "length", "width")] for t, row in there]
    return np.array([t.step for t, _ in there], np.int64), np.array(boxes).reshape(-1, 5)


def _shortest(step_a: IntArray, a: FloatArray, step_b: IntArray, b: FloatArray) -> tuple[int, int, int] | None:
    """Indices into both tracks and the difference of steps of the closest uses of one place; None if too far apart."""
    dx, dy = b[None, :, 0] - a[:, None, 0], b[None, :, 1] - a[:, None, 1]
    reach = 0.5 * (np.hypot(a[0, 3], a[0, 4]) + np.hypot(b[0, 3], b[0, 4]))
    apart = np.abs(step_b[None, :] - step_a[:, None])
    close: BoolArray = (dx**2 + dy**2 < reach**2) & (apart * STEP_S <= PET_HORIZON_S)
    i, j = np.nonzero(close)
    if not len(i):
        return None
    hit = boxes_overlap(dx[i, j], dy[i, j], a[i, 2], b[j, 2], (a[i, 3], a[i, 4]), (b[j, 3], b[j, 4]))
    if not hit.any():
        return None
    i, j = i[hit], j[hit]
    best = int(np.argmin(apart[i, j]))
    return int(i[best]), int(j[best]), int(apart[i[best], j[best]])
