"""Progress: distances travelled by the agents."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from litsim_sim.core.scene import AgentTable, FloatArray
from litsim_sim.core.steps import Steps


def distance_of(tables: Sequence[AgentTable], agent: int, last: int | None = None) -> float | None:
    """Returns the distance [m] that an agent travels between consecutive steps; None if it is never on the road.

    Only steps up to `last` count, if given.
    """
    steps = Steps.of(tables)
    rows, table = steps.track(agent), steps.stacked
    rows = rows if last is None else rows[steps.step[table.number[rows]] <= last]
    follows = np.diff(table.number[rows]) == 1
    parts = np.hypot(np.diff(table.x[rows]), np.diff(table.y[rows]))[follows]
    return float(_added_up(parts)) if len(rows) else None


def mean_progress(
    tables: Sequence[AgentTable], log: Sequence[AgentTable], agents: Collection[int] | None = None
) -> float | None:
    """Returns the mean distance [m] travelled by the agents of `log`, or by those in `agents`; None without agents.

    Only the time in which its log has an agent on the road counts. An agent that is not on the road then, such as one
    held back at its entry, makes no progress.

    Args:
        tables: consecutive steps of the run.
        log: the same steps of the log; also given as `tables` for the progress of the log.
        agents: ids.
    """
    logged = Steps.of(log)
    length = Steps.of(tables).once(_lengths, logged)
    if agents is not None:
        length = length[np.isin(logged.ids, list(agents))]
    return float(np.mean(length)) if len(length) else None


def _lengths(steps: Steps, log: Steps) -> FloatArray:
    """Returns the distance (n,) [m] travelled by each agent of `log`; see :func:`mean_progress`."""
    common = min(len(steps), len(log))
    rows, known = steps.rows_of(log.ids)[:common], log.rows[:common] >= 0
    there = (rows >= 0) & known
    counts = there[1:] & there[:-1]
    at, table = np.where(counts, rows[1:], 0), steps.stacked
    before = np.where(counts, rows[:-1], 0)
    if not len(table):
        return np.zeros(len(log.ids))
    parts = np.where(counts, np.hypot(table.x[at] - table.x[before], table.y[at] - table.y[before]), 0.0)
    return _added_up(parts)


def _added_up(parts: FloatArray) -> FloatArray:
    """Returns the sum of `parts` (k, ...) over the first axis, added in order so that rounding is reproducible."""
    return np.cumsum(parts, axis=0)[-1] if len(parts) else np.zeros(parts.shape[1:])
