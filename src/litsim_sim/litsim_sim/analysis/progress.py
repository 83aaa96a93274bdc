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
    for (before, after), (logged_before, logged_after) in zip(pairwise(tables), pairwise(log), strict=False):
        rows, then, own = (table.rows(ids) for table in (after, before, logged_after))
        counts = np.flatnonzero((rows >= 0) & (then >= 0) & (own >= 0) & (logged_before.rows(ids) >= 0))
        rows, then = rows[counts], then[counts]
        length[counts] += np.hypot(after.x[rows] - before.x[then], after.y[rows] - before.y[then])
    return float(np.mean(length)) if len(ids) else None
