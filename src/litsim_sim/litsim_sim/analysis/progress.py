"""How far the agents travel."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np

from litsim_sim.core.scene import AgentTable


def travelled(tables: Sequence[AgentTable]) -> dict[int, float]:
    """Length [m] of the path of each agent's box centre through consecutive steps."""
    if not len(tables):
        return {}
    ids = np.unique(np.concatenate([table.id for table in tables]))
    length = np.zeros(len(ids))
    for before, after in pairwise(tables):
        rows = before.rows(after.id)
        both = rows >= 0
        moved = np.hypot(after.x[both] - before.x[rows[both]], after.y[both] - before.y[rows[both]])
        length[np.searchsorted(ids, after.id[both])] += moved
    found = dict(zip(ids.tolist(), length.tolist(), strict=True))
    return {agent: found[agent] for table in tables for agent in table.id.tolist()}  # as they appear


def distance_of(tables: Sequence[AgentTable], agent: int) -> float | None:
    """The same [m] of one agent; None where it is never there."""
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
    length = {agent: 0.0 for table in log for agent in table.id.tolist() if agents is None or agent in agents}
    for (before, after), (logged_before, logged_after) in zip(pairwise(tables), pairwise(log), strict=False):
        known = logged_after.id[logged_before.rows(logged_after.id) >= 0]
        rows, then = after.rows(known), before.rows(known)
        both = (rows >= 0) & (then >= 0)
        rows, then = rows[both], then[both]
        moved = np.hypot(after.x[rows] - before.x[then], after.y[rows] - before.y[then])
        for agent, distance in zip(known[both].tolist(), moved.tolist(), strict=True):
            if agent in length:
                length[agent] += distance
    return float(np.mean(list(length.values()))) if length else None
