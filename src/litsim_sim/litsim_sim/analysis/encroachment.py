"""Post-encroachment time: who uses a place that another used before, and how soon (Allen et al. 1978)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numba.types import UniTuple

from litsim_sim.core.compiled import FLOATS2, INTS, float64, int64, kernel
from litsim_sim.core.geometry import boxes_overlap
from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray, IntArray
from litsim_sim.core.steps import Steps

PET_HORIZON_S = 5.0  # between leaving and entering; longer is no encounter


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
    steps = Steps.of(tables)
    table, own_rows = steps.stacked, steps.track(agent)
    if not len(own_rows):
        return []
    boxes = np.column_stack([table.x, table.y, table.yaw, table.length, table.width])
    met = (steps.rows[table.number[own_rows]] >= 0).any(axis=0)
    own_step, own = steps.step[table.number[own_rows]], boxes[own_rows]
    found = []
    for k in np.flatnonzero(met & (steps.ids != agent)).tolist():
        other, rows = int(steps.ids[k]), steps.rows[:, k]
        rows = rows[rows >= 0]
        other_step = steps.step[table.number[rows]]
        entry = closest_use(own_step, own, other_step, boxes[rows])
        if entry is not None:
            i, j, gap = entry
            first, step = (agent, other_step[j]) if own_step[i] < other_step[j] else (other, own_step[i])
            found.append(Encroachment(other, gap * STEP_S, first, int(step)))
    return sorted(found, key=lambda e: (e.pet, e.agent))


def closest_use(step_a: IntArray, a: FloatArray, step_b: IntArray, b: FloatArray) -> tuple[int, int, int] | None:
    """The uses of one place by two tracks that are closest in time.

    Args:
        step_a, step_b: (n,), (m,) steps of the tracks.
        a, b: (n, 5), (m, 5) boxes then: x, y, yaw, length, width.

    Returns:
        Index into the first track, index into the second, and the steps between; None where no place is used by both
        within 5 s.
    """
    if not (len(a) and len(b)):
        return None
    reach = 0.5 * (np.hypot(a[0, 3], a[0, 4]) + np.hypot(b[0, 3], b[0, 4]))
    at_a, at_b = np.asarray(step_a, np.int64), np.asarray(step_b, np.int64)
    i, j, apart = _closest_use(at_a, at_b, np.ascontiguousarray(a), np.ascontiguousarray(b), float(reach))
    return (i, j, apart) if i >= 0 else None


@kernel(UniTuple(int64, 3)(INTS, INTS, FLOATS2, FLOATS2, float64))
def _closest_use(
    step_a: IntArray, step_b: IntArray, a: FloatArray, b: FloatArray, reach: float
) -> tuple[int, int, int]:
    """See :func:`closest_use`: of equally close ones the first, -1 where there are none; centres are in `reach` [m]."""
    best = -1, -1, round(PET_HORIZON_S / STEP_S) + 1
    for i in range(len(a)):
        for j in range(len(b)):
            apart = abs(step_b[j] - step_a[i])
            if apart >= best[2]:
                continue
            dx, dy = b[j, 0] - a[i, 0], b[j, 1] - a[i, 1]
            if dx * dx + dy * dy < reach * reach and overlap(
                dx, dy, a[i, 2], b[j, 2], a[i, 3], a[i, 4], b[j, 3], b[j, 4]
            ):
                best = i, j, apart
    return best


def times_since_others(tables: Sequence[AgentTable]) -> Iterator[tuple[FloatArray, IntArray]]:
    """For every table, how long ago another agent's box covered a place that each agent's box covers now.

    Yields:
        time (n,) [s], 0 in contact and inf beyond :data:`PET_HORIZON_S`, and id (n,) of that other agent, the lowest of
        several, -1 where there is none. The smallest time of an agent is the shortest post-encroachment time as in
        :func:`encroachments` among the pairs in which it came second.
    """
    recent: deque[AgentTable] = deque()
    for table in tables:
        recent.append(table)
        while (table.step - recent[0].step) * STEP_S > PET_HORIZON_S:
            recent.popleft()
        yield _since_others(table, recent)


def _since_others(table: AgentTable, recent: Sequence[AgentTable]) -> tuple[FloatArray, IntArray]:
    from scipy.spatial import KDTree  # which takes as long to import as numba, and most measures do without

    names = ("id", "x", "y", "yaw", "length", "width")
    ids, x, y, yaw, length, width = (np.concatenate([getattr(t, name) for t in recent]) for name in names)
    age = np.concatenate([np.full(len(t), (table.step - t.step) * STEP_S) for t in recent])
    since, other = np.full(len(table), np.inf), np.full(len(table), -1, np.int64)
    usable = np.flatnonzero(np.isfinite(x + y))
    own = np.flatnonzero(np.isfinite(table.x + table.y))
    if not len(own):
        return since, other
    reach = float(np.hypot(length, width).max())
    now, before = np.column_stack([table.x, table.y])[own], np.column_stack([x, y])[usable]
    near = KDTree(now).sparse_distance_matrix(KDTree(before), reach, output_type="ndarray")
    a, b = own[near["i"]], usable[near["j"]]
    a, b = a[ids[b] != table.id[a]], b[ids[b] != table.id[a]]
    size = ((table.length[a], table.width[a]), (length[b], width[b]))
    hit = boxes_overlap(x[b] - table.x[a], y[b] - table.y[a], table.yaw[a], yaw[b], *size)
    a, b = a[hit], b[hit]
    order = np.lexsort((ids[b], age[b], a))
    agents, first = np.unique(a[order], return_index=True)
    since[agents], other[agents] = age[b[order][first]], ids[b[order][first]]
    return since, other
