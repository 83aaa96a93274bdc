"""How far agents travel: one alone, and all of a log together while it knows them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from litsim_eval.analysis.measures.progress import beside_logged_way, distance_of, mean_progress
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.steps import Steps
from made_runs import table


@pytest.fixture
def tables() -> list[AgentTable]:
    """Two that come and go; one is away for a step, in which it travels nothing."""
    walk = np.random.default_rng(0).normal(0.0, 3.0, (6, 2, 2)).cumsum(axis=0)
    there = {7: (0, 1, 3, 4), 3: (1, 2, 3, 4, 5)}

    def at(step: int) -> AgentTable:
        present = [(n, k) for n, k in enumerate(there) if step in there[k]]
        return table(step, *({"id": k, "x": walk[step, n, 0], "y": walk[step, n, 1]} for n, k in present))

    return [at(step) for step in range(6)]


def test_the_distance_of_one(tables: list[AgentTable]) -> None:
    for agent in (7, 3):
        expected = 0.0
        for before, after in pairwise(tables):
            i, k = before.row(agent), after.row(agent)
            if i >= 0 and k >= 0:
                expected += float(np.hypot(after.x[k] - before.x[i], after.y[k] - before.y[i]))
        assert expected > 0.0
        assert distance_of(tables, agent) == expected
        assert mean_progress(tables, tables, {agent}) == pytest.approx(expected)
    assert mean_progress(tables, tables) == pytest.approx(0.5 * sum(distance_of(tables, k) or 0.0 for k in (7, 3)))


def test_who_is_never_there_has_no_distance(tables: list[AgentTable]) -> None:
    assert distance_of(tables, 5) is None and distance_of([], 3) is None
    assert distance_of(tables[2:3], 3) == 0.0
    assert mean_progress(tables, tables, {5}) is None and mean_progress([], []) is None


def log_of(steps: int) -> list[AgentTable]:
    """Three that drive 1 m a step."""
    return [table(step, *({"id": k, "x": 1.0 * step, "y": 5.0 * k} for k in (1, 2, 3))) for step in range(steps + 1)]


def test_progress_is_what_all_of_the_log_have_made_while_it_knows_them() -> None:
    log = [t if t.step < 10 else t.take(t.id != 3) for t in log_of(20)]
    run = [replace(t, x=2.0 * t.x) for t in log_of(20)]  # twice as fast, and 3 drives on
    assert mean_progress(log, log) == pytest.approx(49.0 / 3)
    assert mean_progress(run, log) == pytest.approx(98.0 / 3)
    assert mean_progress(run, log, {3}) == pytest.approx(18.0)
    assert mean_progress(log, log, set()) is None and mean_progress(run, []) is None


def test_who_is_held_back_at_his_entry_makes_no_progress_there() -> None:
    log = log_of(20)
    late = [t if t.step >= 15 else t.take(t.id != 2) for t in log]
    never = [t.take(t.id != 2) for t in log]
    assert mean_progress(late, log) == pytest.approx((20.0 + 5.0 + 20.0) / 3)
    assert mean_progress(never, log) == pytest.approx(40.0 / 3)
    assert mean_progress(never[:11], log) == pytest.approx(20.0 / 3), "a run that is over earlier"


def test_the_logged_way_is_road_where_the_map_ends() -> None:
    log = Steps.of(log_of(20))
    assert beside_logged_way(log, 2, np.array([3.5, 10.0, 24.0]), np.array([10.0, 11.5, 13.0])).tolist() == [
        0.0,
        1.5,
        5.0,
    ]
    assert beside_logged_way(Steps.of(log_of(0)), 2, np.array([3.0]), np.array([14.0])).tolist() == [5.0]
