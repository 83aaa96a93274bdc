"""How far the agents travel."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np

from litsim_sim.core.scene import AgentTable


def distance_of(tables: Sequence[AgentTable], agent: int) -> float | None:
    """Length [m] of the path of an agent's box centre through consecutive steps; None where it is never there."""
    places = [(number, table, row) for number, table in enumerate(tables) if (row := table.row(agent)) >= 0]
    length = 0.0
    for (number, before, i), (following, after, k) in pairwise(places):
        if following == number + 1:
            length += float(np.hypot(after.x[k] - before.x[i], after.y[k] - before.y[i]))
    return length if places else None


def mean_progress(
    tables: Sequence[AgentTable], log: Sequence[AgentTable], agents: Collection[int] | None = None
) -> float | None:
    """Mean distance [m] travelled by the agents of `log`, or by those of `agents`; None where there are none.

    Only steps count from and to which the log of an agent knows it: who drives on when its log has ended makes no
    progress by that. Who is not on the road then, such as who is held back where he would enter, makes none either.

    Args:
        tables: of consecutive steps.
        log: of the same steps, `tables` itself for the progress of the log.
        agents: ids.
    """
    ids = np.unique(np.concatenate([np.empty(0, np.int64), *(table.id for table in log)]))
    if agents is not None:
        ids = ids[np.isin(ids, list(agents))]
    length = np.zeros(len(ids))
    found = [table.rows(ids) for table in tables]
    known = [table.rows(ids) >= 0 for table in log]
    steps = zip(pairwise(tables), pairwise(found), pairwise(known), strict=False)
    for (before, after), (rows_before, rows_after), (known_before, known_after) in steps:
        counts = np.flatnonzero((rows_after >= 0) & (rows_before >= 0) & known_after & known_before)
        j, i = rows_after[counts], rows_before[counts]
        length[counts] += np.hypot(after.x[j] - before.x[i], after.y[j] - before.y[i])
    return float(np.mean(length)) if len(ids) else None
