"""The review of agents off their logs: the next state of each, whatever the others are in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from litsim_policy.conflict.config import TakeoverConfig
from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.diverged import DivergedAgents, Residuals
from litsim_policy.conflict.takeover import obstructed, review
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverState

NOW = 40
HELD, HANDBACK, RELEASED = TakeoverState.HELD, TakeoverState.HANDBACK, TakeoverState.RELEASED
CONFIG = TakeoverConfig(held_steps_min=5, clear_steps=5)


def lane(y: float) -> ReferencePath:
    return ReferencePath.of(np.column_stack([np.arange(500.0), np.full(500, y)]))


def diverged(count: int) -> DivergedAgents:
    """Agents 1 .. count, far apart in y, held since step 10 with their goals at x = 50."""
    off = DivergedAgents.empty()
    for agent in range(1, count + 1):
        y = 20.0 * agent
        conflict = Conflict(agent, 99, 1.0, np.array([50.0, y, 0.0]), 0.9)
        off = off.joined(
            DivergedAgents.opened(conflict, 10, TakeoverReason.CONFLICT, lane(y), PathSource.ROUTE, lane(y))
        )
    off.source[:] = PathSource.ROUTE
    return off


def residuals(off: DivergedAgents, ahead: float = 0.0) -> Residuals:
    """Everybody's log is `ahead` of x = 100 on the path."""
    many = np.ones(len(off))
    return Residuals(many > 0, 100.0 + ahead * many, off.pose[:, 1], abs(ahead) * many, 0 * many, 0 * many)


@pytest.fixture
def table_of(agent_table):
    """Agents of `off` at x, on their paths, and others."""

    def make(off: DivergedAgents, *others: dict[str, float], x: float = 100.0):
        mine = ({"id": a, "x": x, "y": 20.0 * a, "speed": 10.0} for a in off.agent.tolist())
        return agent_table(NOW, *mine, *others)

    return make


def test_each_agent_goes_its_own_way(table_of) -> None:
    off = diverged(7)
    off.clear[:] = [3, 4, 9, 4, 0, 0, 0]
    off.state[:] = [HELD, HELD, HELD, HELD, HANDBACK, HANDBACK, HANDBACK]
    off.detected_step[3] = NOW - 4
    found = residuals(off)
    found = replace(found, known=np.array([True] * 6 + [False]), speed=np.array([0, 0, 0, 0, 0, 2.0, 0]))
    blocked = np.array([False, False, True, False, False, False, False])
    review(CONFIG, off, table_of(off), np.arange(7), found, blocked)
    expected = [
        HELD,  # free for four steps only
        HANDBACK,  # the fifth, beyond its goal
        HELD,  # in conflict: begins to count again
        HELD,  # free for long enough, but not held for long enough
        RELEASED,  # back on its log
        HANDBACK,  # too fast for its log as yet
        HELD,  # has no log to go back to
    ]
    assert off.state.tolist() == expected
    assert off.clear.tolist() == [4, 5, 0, 5, 1, 1, 0]
    assert off.in_conflict.tolist() == blocked.tolist()
    assert off.source.tolist() == [PathSource.LOGGED if k in (1, 5) else PathSource.ROUTE for k in range(7)]


def test_before_the_goal_an_agent_is_free_for_twice_as_long(table_of) -> None:
    off = diverged(2)
    off.clear[:] = [8, 9]
    review(CONFIG, off, table_of(off, x=40.0), np.arange(2), residuals(off), np.zeros(2, np.bool_))
    assert off.state.tolist() == [HELD, HANDBACK]


@pytest.mark.parametrize(
    ("field", "limit"), [("position", 0.5), ("speed", 1.5), ("speed", -1.5), ("yaw", 0.1), ("yaw", -0.1)]
)
def test_release_needs_every_residual_within_its_bound(table_of, field: str, limit: float) -> None:
    off = diverged(2)
    off.state[:] = HANDBACK
    found = replace(residuals(off), **{field: np.array([limit, 1.001 * limit])})
    review(CONFIG, off, table_of(off), np.arange(2), found, np.zeros(2, np.bool_))
    assert off.state.tolist() == [RELEASED, HANDBACK]


def test_who_stands_between_an_agent_and_its_log_obstructs_it(table_of) -> None:
    off = diverged(3)
    others = [{"id": 50, "x": 130.0, "y": 20.0}, {"id": 51, "x": 190.0, "y": 40.0}, {"id": 52, "x": 130.0, "y": 63.0}]
    table, everybody = table_of(off, *others), np.arange(3)
    found = residuals(off, ahead=50.0)
    assert obstructed(off, everybody, table, table.rows(off.agent), found).tolist() == [True, False, False]
    assert obstructed(off, np.array([1]), table, table.rows(off.agent), found).tolist() == [False]
    assert obstructed(off, everybody[:0], table, table.rows(off.agent), found).tolist() == []
    review(CONFIG, off, table, table.rows(off.agent), found, np.zeros(3, np.bool_))
    assert off.clear.tolist() == [0, 1, 1]
