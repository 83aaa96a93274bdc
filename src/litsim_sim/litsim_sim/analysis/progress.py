"""How far the agents travel."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np

from litsim_sim.core.scene import AgentTable


def travelled(tables: Sequence[AgentTable]) -> dict[int, float]:
    """Length [m] of the path of each agent's box centre through consecutive steps."""
    length: dict[int, float] = {agent: 0.0 for table in tables for agent in table.id.tolist()}
    for before, after in pairwise(tables):
        rows = before.rows(after.id)
        both = rows >= 0
        moved = np.hypot(after.x[both] - before.x[rows[both]], after.y[both] - before.y[rows[both]])
        for agent, distance in zip(after.id[both].tolist(), moved.tolist(), strict=True):
            length[agent] += distance
    return length


def mean_progress(tables: Sequence[AgentTable], agents: Collection[int] | None = None) -> float | None:
    """Mean distance [m] travelled by all agents, or by those of `agents` that are there; None where there are none."""
    lengths = [length for agent, length in travelled(tables).items() if agents is None or agent in agents]
    return float(np.mean(lengths)) if lengths else None
