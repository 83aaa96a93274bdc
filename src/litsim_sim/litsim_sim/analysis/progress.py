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


def mean_progress(tables: Sequence[AgentTable], agents: Collection[int] | None = None) -> float | None:
    """Mean distance [m] travelled by all agents, or by those of `agents` that are there; None where there are none."""
    lengths = [length for agent, length in travelled(tables).items() if agents is None or agent in agents]
    return float(np.mean(lengths)) if lengths else None
