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
    return float(np.append(0.0, parts).cumsum()[-1]) if len(rows) else None  # in order: rounding is reproducible


def mean_progress(
    tables: Sequence[AgentTable], log: Sequence[AgentTable], agents: Collection[int] | None = None
) -> float | None:
    """Returns the mean distance [m] travelled by the agents of `log`, or by those in `agents`; None without agents.

    Only the time in which its log has an agent on the road counts. An agent that is not on the road then, such as one
    held back at its entry, makes no progress. `tables` and `log` are the same consecutive steps.
    """
    logged = Steps.of(log)
    length = Steps.of(tables).once(_lengths, logged)
    if agents is not None:
        length = length[np.isin(logged.ids, list(agents))]
    return float(np.mean(length)) if len(length) else None


def _lengths(steps: Steps, log: Steps) -> FloatArray:
    """Returns the distance (n,) [m] travelled by each agent of `log`; see :func:`mean_progress`."""
    total = np.zeros(len(log.ids))
    for begin, end in log.blocks():
        part, then = (each.part(max(0, begin - 1), end) for each in (steps, log))
        table, number, ids = part.stacked, then.stacked.number, then.stacked.id
        rows, before = (part.rows_at(number - back, ids) for back in (0, 1))
        counts = (rows >= 0) & (before >= 0) & (then.rows_at(number - 1, ids) >= 0)
        at, before = rows[counts], before[counts]
        parts = np.hypot(table.x[at] - table.x[before], table.y[at] - table.y[before])
        np.add.at(total, log.ids.searchsorted(ids[counts]), parts)  # in order of the steps, too
    return total
