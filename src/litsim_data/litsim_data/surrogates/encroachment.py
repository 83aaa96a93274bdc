"""Post-encroachment time: how soon one agent uses a place that another has used before (Allen et al. 1978)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import STEP_S, AgentRows, AgentTable, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.kernels.compiled import Floats, Floats2, Ints, kernel

PET_HORIZON_S = 5.0  # longest time between leaving and entering that counts as an encounter
PET_HORIZON = round(PET_HORIZON_S / STEP_S)  # [steps]


@dataclass(frozen=True)
class Encroachment:
    """Two agents that use the same place one after the other, in crossing or merging.

    Attributes:
        agent: id of the other agent.
        pet: shortest time between the first leaving and the second entering a place that both sweep [s].
        first: id of the agent that was there first.
        step: step at which the second entered.
    """

    agent: int
    pet: float
    first: int
    step: int


def encroachments(tables: Sequence[AgentTable], agent: int) -> list[Encroachment]:
    """Returns the post-encroachment times of up to 5 s of `agent` with every other agent, shortest first.

    Each is the time between two steps at which their boxes overlap in space, to the resolution of a step; the two need
    not be on the road at the same time. Following in the same lane counts too: the time is the headway to the rear of
    the leader.
    """
    steps = Steps.of(tables)
    closest: dict[int, tuple[int, int, int]] = {}  # by other agent: steps between, own step, step of the other
    for begin, end in steps.blocks():
        part = steps.part(max(0, begin - PET_HORIZON), end)
        table, own_rows = part.stacked, part.track(agent)
        if not len(own_rows):
            continue
        own_step, own = part.step[table.number[own_rows]], _boxes(table, own_rows)
        in_time = (part.step >= own_step[0] - PET_HORIZON) & (part.step <= own_step[-1] + PET_HORIZON)
        for other in np.unique(table.id[in_time[table.number]]).tolist():
            rows = part.track(other)
            other_step = part.step[table.number[rows]]
            if other != agent and (uses := closest_use(own_step, own, other_step, _boxes(table, rows))) is not None:
                i, j, gap = uses
                use = gap, int(own_step[i]), int(other_step[j])
                closest[other] = min(use, closest.get(other, use))
    encounters = [
        Encroachment(other, gap * STEP_S, agent if own_step < step else other, max(own_step, step))
        for other, (gap, own_step, step) in closest.items()
    ]
    return sorted(encounters, key=lambda e: (e.pet, e.agent))


def _boxes(table: AgentRows, rows: IntArray) -> FloatArray:
    """Returns the boxes (k, 5) in `rows` (k,): x, y, yaw, length, width."""
    return np.column_stack([values[rows] for values in (table.x, table.y, table.yaw, table.length, table.width)])


def closest_use(step_a: IntArray, a: FloatArray, step_b: IntArray, b: FloatArray) -> tuple[int, int, int] | None:
    """Returns the two uses of one place by two tracks that are closest in time.

    Args:
        step_a, step_b: (n,), (m,) steps of the tracks, ascending.
        a, b: (n, 5), (m, 5) boxes at these steps: x, y, yaw, length, width.

    Returns:
        Index into the first track, index into the second, and the number of steps between; None if the tracks use no
        common place within 5 s.
    """
    if not (len(a) and len(b)):
        return None
    reach = 0.5 * (np.hypot(a[0, 3], a[0, 4]) + np.hypot(b[0, 3], b[0, 4]))
    at_a, at_b = np.asarray(step_a, np.int64), np.asarray(step_b, np.int64)
    i, j, apart = _closest_use(at_a, at_b, np.ascontiguousarray(a), np.ascontiguousarray(b), float(reach))
    return (i, j, apart) if i >= 0 else None


@kernel
def _closest_use(step_a: Ints, step_b: Ints, a: Floats2, b: Floats2, reach: float) -> tuple[int, int, int]:
    """See :func:`closest_use`; the first of equally close uses, -1 for none; `reach` bounds the centre distance [m]."""
    best = -1, -1, PET_HORIZON + 1
    for i in range(len(a)):
        for j in range(np.searchsorted(step_b, step_a[i] - best[2]), len(b)):
            if step_b[j] - step_a[i] >= best[2]:
                break
            apart = abs(step_b[j] - step_a[i])
            if apart >= best[2]:
                continue
            dx, dy = b[j, 0] - a[i, 0], b[j, 1] - a[i, 1]
            if dx * dx + dy * dy < reach * reach and overlap(
                dx, dy, a[i, 2], b[j, 2], a[i, 3], a[i, 4], b[j, 3], b[j, 4]
            ):
                best = i, j, apart
    return best


def times_since_others(tables: Sequence[AgentTable]) -> tuple[FloatArray, IntArray]:
    """Returns, for every agent at every step, the time since another agent covered a place that its own box covers now.

    Returns:
        Time (m,) [s], 0 in contact and inf beyond :data:`PET_HORIZON_S`, and id (m,) of the other agent, the lowest of
        several, -1 for none; one entry per row of :attr:`litsim_sim.core.steps.Steps.stacked`. An agent's smallest time
        is its shortest post-encroachment time, see :func:`encroachments`, among the pairs in which it came second.
    """
    steps = Steps.of(tables)
    table = steps.stacked
    since, other = np.full(len(table), np.inf), np.full(len(table), -1, np.int64)
    there = np.flatnonzero(np.isfinite(table.x + table.y))
    if not len(there):
        return since, other
    place = max((table.x, table.y), key=lambda values: float(np.ptp(values[there])))
    rows = there[np.lexsort((place[there], table.number[there]))]
    begin = table.number[rows].searchsorted(np.arange(len(steps) + 1))
    boxes = np.stack([values[rows] for values in (table.x, table.y, table.yaw, table.length, table.width)])
    reach = float(np.hypot(boxes[3], boxes[4]).max())
    since[rows], other[rows] = _since_others(steps.step, begin, table.id[rows], place[rows], boxes, reach)
    return since, other


@kernel
def _since_others(
    step: Ints, begin: Ints, agent: Ints, place: Floats, boxes: Floats2, reach: float
) -> tuple[Floats, Ints]:
    """See :func:`times_since_others`; rows (m,) have finite positions and are sorted by step, then by `place`.

    Args:
        step, begin: (S,) steps, and (S + 1,) row at which each begins.
        agent: (m,) ids.
        place: (m,) coordinate along one axis [m].
        boxes: (5, m) x, y, yaw, length, width.
        reach: largest distance between the centres of two overlapping boxes [m].
    """
    x, y, yaw, length, width = boxes
    since, other = np.full(len(agent), math.inf), np.full(len(agent), -1, np.int64)
    for k in range(len(step)):
        for a in range(begin[k], begin[k + 1]):
            for then in range(k, -1, -1):
                age = step[k] - step[then]
                if age > PET_HORIZON or other[a] >= 0:
                    break
                first, last = begin[then], begin[then + 1]
                for b in range(first + np.searchsorted(place[first:last], place[a] - reach), last):
                    if place[b] > place[a] + reach:
                        break
                    if agent[b] == agent[a] or (0 <= other[a] < agent[b]):
                        continue
                    dx, dy = x[b] - x[a], y[b] - y[a]
                    if overlap(dx, dy, yaw[a], yaw[b], length[a], width[a], length[b], width[b]):
                        since[a], other[a] = age * STEP_S, agent[b]
    return since, other
