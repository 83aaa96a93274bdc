"""The review of agents off their logs: the next state of each, whatever the others are in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from litsim_policy.conflict.detection import Conflict
from litsim_policy.conflict.life_cycle import Residuals, obstructed, review
from litsim_policy.conflict.off_log import OffLog

from litsim_policy.conflict.takeover import TakeoverConfig
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverState

NOW = 40
HELD, HANDBACK, RELEASED = TakeoverState.HELD, TakeoverState.HANDBACK, TakeoverState.RELEASED
CONFIG = TakeoverConfig(held_steps_min=5, clear_steps=5)


def lane(y: float) -> ReferencePath:
    return ReferencePath.of(np.column_stack([np.arange(500.0), np.full(500, y)]))


def off_log(count: int) -> OffLog:
    """Agents 1 .. count, far apart in y, held since step 10 with their goals at x = 50."""
    off = OffLog.empty()
    for agent in range(1, count + 1):
        y = 20.0 * agent
        conflict = Conflict(agent, 99, 1.0, np.array([50.0, y, 0.0]), 0.9)
        off = off.joined(OffLog.opened(conflict, 10, TakeoverReason.CONFLICT, lane(y), PathSource.ROUTE, lane(y)))
    off.source[:] = PathSource.ROUTE
    return off


def residuals(off: OffLog, ahead: float = 0.0) -> Residuals:
    """Everybody's log is `ahead` of x = 100 on the path."""
    many = np.ones(len(off))
    return Residuals(many > 0, 100.0 + ahead * many, off.pose[:, 1], abs(ahead) * many, 0 * many, 0 * many)


@pytest.fixture
def table_of(agent_table):
    """Agents of `off` at x, on their paths, and others."""

    def make(off: OffLog, *others: dict[str, float], x: float = 100.0):
        mine = ({"id": a, "x": x, "y": 20.0 * a, "speed": 10.0} for a in off.agent.tolist())
        return agent_table(NOW, *mine, *others)

    return make


def test_each_agent_goes_its_own_way(table_of) -> None:
    off = off_log(7)
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
    off = off_log(2)
    off.clear[:] = [8, 9]
    review(CONFIG, off, table_of(off, x=40.0), np.arange(2), residuals(off), np.zeros(2, np.bool_))
    assert off.state.tolist() == [HELD, HANDBACK]


@pytest.mark.parametrize(
    ("field", "limit"), [("position", 0.5), ("speed", 1.5), ("speed", -1.5), ("yaw", 0.1), ("yaw", -0.1)]
)
def test_release_needs_every_residual_within_its_bound(table_of, field: str, limit: float) -> None:
    off = off_log(2)
    off.state[:] = HANDBACK
    found = replace(residuals(off), **{field: np.array([limit, 1.001 * limit])})
    review(CONFIG, off, table_of(off), np.arange(2), found, np.zeros(2, np.bool_))
    assert off.state.tolist() == [RELEASED, HANDBACK]


def test_who_stands_between_an_agent_and_its_log_obstructs_it(table_of) -> None:
    off = off_log(3)
    others = [{"id": 50, "x": 130.0, "y": 20.0}, {"id": 51, "x": 190.0, "y": 40.0}, {"id": 52, "x": 130.0, "y": 63.0}]
    table, everybody = table_of(off, *others), np.arange(3)
    found = residuals(off, ahead=50.0)
    assert obstructed(off, everybody, table, table.rows(off.agent), found).tolist() == [True, False, False]
    assert obstructed(off, np.array([1]), table, table.rows(off.agent), found).tolist() == [False]
    assert obstructed(off, everybody[:0], table, table.rows(off.agent), found).tolist() == []
    review(CONFIG, off, table, table.rows(off.agent), found, np.zeros(3, np.bool_))
    assert off.clear.tolist() == [0, 1, 1]


def test_residuals_are_measured_from_the_log_with_its_lag(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0, speed=10.0), track(2, x=50.0, speed=10.0, last=30)).log
    table = placed(log.table(20), 1, x=log.x[0, 15] + 3.0, y=log.y[0, 15] + 4.0, speed=12.0, yaw=0.25)
    rows, lag = np.arange(2), np.array([5, 21])
    found = Residuals.of(log, rows, lag, table, rows)
    assert found.known.tolist() == [True, False], "20 steps into the run no log lags by 21"
    assert (found.x[0], found.y[0]) == (log.x[0, 15], log.y[0, 15])
    assert [found.position[0], found.speed[0], found.yaw[0]] == pytest.approx([5.0, 2.0, 0.25])


@given(st.integers(0, 2**32))
def test_residuals_of_many_are_those_of_numpy(make_scenario, track, seed: int) -> None:
    log = make_scenario(*(track(k, x=40.0 * k, y=-9.0, speed=9.0 + k, yaw=0.1 * k, last=20 + k) for k in (1, 2, 3))).log
    random = np.random.default_rng(seed)
    table = log.table(19)
    moved = {f: getattr(table, f) + random.normal(0.0, 3.0, 3) for f in ("x", "y", "yaw", "speed")}
    table = replace(table, step=int(random.integers(0, 40)), **moved)
    rows, lag = random.permutation(3), random.integers(0, 30, 3)
    found = Residuals.of(log, rows, lag, table, rows)
    now = table.step - lag
    at = rows, np.clip(now, 0, log.steps - 1)
    assert (found.known == ((now >= 0) & (now < log.steps) & log.valid[at])).all()
    assert (found.x == log.x[at]).all() and (found.y == log.y[at]).all()
    assert (found.position == np.hypot(table.x[rows] - log.x[at], table.y[rows] - log.y[at])).all()
    assert (found.speed == table.speed[rows] - log.speed[at]).all()
    assert (found.yaw == wrap_angle(table.yaw[rows] - log.yaw[at])).all()
    position, speed = found.reported
    assert (position[~found.known] == -1.0).all() and (speed[~found.known] == 0.0).all()
    assert (position[found.known] == found.position[found.known]).all()
    which = random.random(3) < 0.5
    assert (found.take(which).position == found.position[which]).all()
