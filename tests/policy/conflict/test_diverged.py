"""The table of agents off their logs: who is in it, in which order, and what is reported of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.diverged import DivergedAgents, Residuals
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverState

STRAIGHT = ReferencePath.of(np.column_stack([np.arange(300.0), np.zeros(300)]))
ROUTE = ReferencePath.of(np.column_stack([np.arange(20.0, 260.0), np.full(240, 1.0)]))


def opened(agent: int, path: ReferencePath = ROUTE, x: float = 50.0) -> DivergedAgents:
    conflict = Conflict(agent, agent + 100, 1.5, np.array([x, 0.5, 0.1]), 0.75)
    source = PathSource.LOGGED if path is STRAIGHT else PathSource.ROUTE
    return DivergedAgents.opened(conflict, 7, TakeoverReason.CONFLICT, path, source, STRAIGHT)


def test_tables_join_in_order_of_ids_and_keep_their_columns_together() -> None:
    both = opened(9, x=50.0).joined(opened(4, STRAIGHT, x=60.0), opened(6, x=70.0))
    assert both.agent.tolist() == [4, 6, 9] and both.opponent.tolist() == [104, 106, 109]
    assert both.goal_s.tolist() == pytest.approx([60.0, 50.0, 30.0])
    assert both.source.tolist() == [PathSource.LOGGED, PathSource.ROUTE, PathSource.ROUTE]
    kept = both.kept(both.agent != 6)
    assert kept.agent.tolist() == [4, 9] and kept.pose[:, 0].tolist() == [60.0, 50.0]
    assert [path is ROUTE for path in kept.path] == [False, True]
    assert len(DivergedAgents.empty().joined(kept)) == 2 and len(DivergedAgents.empty()) == 0


def test_who_stays_keeps_the_layout_of_its_paths() -> None:
    both = opened(1).joined(opened(2, STRAIGHT))
    here = np.array([0]), np.array([100.0]), np.array([0.0])
    assert both.paths.project(np.array([1]), *here[1:]).s.tolist() == [100.0]
    kept = both.kept(np.array([False, True]))
    assert kept.paths.count.tolist() == [len(STRAIGHT.points)] and kept.paths.project(*here).s.tolist() == [100.0]
    assert kept.logged_paths.count.tolist() == [len(STRAIGHT.points)]


def test_who_returns_follows_the_logged_path_to_the_same_goal() -> None:
    off = opened(1).joined(opened(2))
    before = off.paths.count[1]
    off.return_to_log(np.array([False, True]))
    assert off.path.tolist() == [ROUTE, STRAIGHT]
    assert off.source.tolist() == [PathSource.ROUTE, PathSource.LOGGED]
    assert off.goal_s.tolist() == pytest.approx([30.0, 50.0])
    assert off.paths.count[1] > before, "the batch of paths is that of the paths now"


def test_a_report_gives_the_path_from_a_little_behind_the_agent_on() -> None:
    off = opened(1).joined(opened(2, STRAIGHT))
    off.in_conflict[:] = [True, False]
    here = np.array([100.0, 200.0])
    first, second = off.report(
        here, np.array([1.0, 0.0]), (np.array([0.5, -1.0]), np.array([2.0, 0.0])), np.array([0, 3])
    )
    assert first.reference_path[:, 0].tolist() == list(range(95, 252))
    assert second.reference_path[:, 0].tolist() == list(range(195, 300))
    assert (first.agent, first.opponent, first.state, first.reason) == (
        1,
        101,
        TakeoverState.HELD,
        TakeoverReason.CONFLICT,
    )
    assert (first.detected_step, first.time_to_conflict, first.overlap_probability) == (7, 1.5, 0.75)
    assert first.goal_pose == first.conflict_pose == (50.0, 0.5, 0.1)
    assert (first.log_collision_predicted, second.log_collision_predicted) == (True, False)
    assert (first.residual_position, first.residual_speed, first.time_shift) == (0.5, 2.0, 0.0)
    assert (second.residual_position, second.time_shift) == (-1.0, pytest.approx(0.3))
    assert DivergedAgents.empty().report(*[np.empty(0)] * 2, (np.empty(0), np.empty(0)), np.empty(0, np.int64)) == ()


# Residuals


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
    assert (found.kept(which).position == found.position[which]).all()
