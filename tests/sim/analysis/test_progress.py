"""How far agents travel: one alone as all of them together."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from litsim_sim.analysis.progress import distance_of, mean_progress, travelled
from litsim_sim.core.scene import AgentTable


@pytest.fixture
def tables(agent_table: Callable[..., AgentTable]) -> list[AgentTable]:
    """Two that come and go; one is away for a step, in which it travels nothing."""
    walk = np.random.default_rng(0).normal(0.0, 3.0, (6, 2, 2)).cumsum(axis=0)
    there = {7: (0, 1, 3, 4), 3: (1, 2, 3, 4, 5)}

    def at(step: int) -> AgentTable:
        present = [(n, k) for n, k in enumerate(there) if step in there[k]]
        return agent_table(step, *({"id": k, "x": walk[step, n, 0], "y": walk[step, n, 1]} for n, k in present))

    return [at(step) for step in range(6)]


def test_one_alone_travels_as_far_as_among_all(tables: list[AgentTable]) -> None:
    found = travelled(tables)
    assert list(found) == [7, 3], "in the order in which they appear"
    for agent in found:
        expected = 0.0
        for before, after in pairwise(tables):
            i, k = before.row(agent), after.row(agent)
            if i >= 0 and k >= 0:
                expected += float(np.hypot(after.x[k] - before.x[i], after.y[k] - before.y[i]))
        assert expected > 0.0 and found[agent] == distance_of(tables, agent) == expected
    assert mean_progress(tables) == np.mean(list(found.values()))
    assert mean_progress(tables, {3}) == found[3]


def test_who_is_never_there_has_no_distance(tables: list[AgentTable]) -> None:
    assert distance_of(tables, 5) is None and distance_of([], 3) is None and travelled([]) == {}
    assert distance_of(tables[2:3], 3) == 0.0
    assert mean_progress(tables, {5}) is None
