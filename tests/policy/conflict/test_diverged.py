"""The table of agents off their logs: who is in it, in which order, and what is reported of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from litsim_policy.conflict.diverged import DivergedAgents, DivergedNow
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverState

STRAIGHT = ReferencePath(np.column_stack([np.arange(300.0), np.zeros(300)]))
ROUTE = ReferencePath(np.column_stack([np.arange(20.0, 260.0), np.full(240, 1.0)]))


def opened(agent: int, path: ReferencePath = ROUTE, x: float = 50.0) -> DivergedAgents:
    goal, reason = np.array([x, 0.5, 0.1]), TakeoverReason.CONFLICT
    source = PathSource.LOGGED if path is STRAIGHT else PathSource.ROUTE
    paths, measured = (path, source, STRAIGHT), {"time_to_conflict": 1.5, "overlap_probability": 0.75}
    return DivergedAgents.opened(agent, agent + 100, 7, reason, goal, paths, **measured)


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
    assert kept.paths.counts.tolist() == [len(STRAIGHT.points)] and kept.paths.project(*here).s.tolist() == [100.0]
    assert kept.logged_paths.counts.tolist() == [len(STRAIGHT.points)]


def test_the_paths_of_some_are_those_of_all_whether_these_are_laid_out_or_not() -> None:
    both, here = opened(1).joined(opened(2, STRAIGHT)), (np.array([100.0]), np.array([0.0]))
    for _ in range(2):
        (s,), (d,) = (getattr(both.paths_of(np.array([1])).project(np.array([0]), *here), name) for name in ("s", "d"))
        assert (s, d) == (100.0, 0.0)
        assert len(both.paths.each) == len(both.paths_of(np.arange(2)).each) == 2


def test_who_returns_follows_the_logged_path_to_the_same_goal() -> None:
    off = opened(1).joined(opened(2))
    before = off.paths.counts[1]
    off.return_to_log(np.array([1]))
    assert off.path.tolist() == [ROUTE, STRAIGHT]
    assert off.source.tolist() == [PathSource.ROUTE, PathSource.LOGGED]
    assert off.goal_s.tolist() == pytest.approx([30.0, 50.0])
    assert off.paths.counts[1] > before, "the batch of paths is that of the paths now"


def test_a_report_gives_the_path_from_a_little_behind_the_agent_on(agent_table) -> None:
    off = opened(1).joined(opened(2, STRAIGHT))
    off.in_conflict[:] = [True, False]
    table = agent_table(9, {"id": 1, "x": 100.0, "y": 1.0, "speed": 7.0}, {"id": 2, "x": 200.0})
    recorded, log_x = np.array([True, False]), np.array([99.5, 0.0])
    place = log_x, table.y, table.yaw, np.array([5.0, 0.0])
    rows, log, own = np.arange(2), SimpleNamespace(ids=table.id), (table.x, table.y, table.yaw, table.speed)
    first, second = DivergedNow(off, table, rows, log, rows, np.array([0, 3]), recorded, *place, *own).report()
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
    assert (second.residual_position, second.residual_speed, second.time_shift) == (-1.0, 0.0, pytest.approx(0.3))


# Places in the logs


def test_places_and_residuals_are_those_of_the_log_with_its_lag(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0, speed=10.0), track(2, x=50.0, speed=10.0, last=30)).log
    table = placed(log.table(20), 1, x=log.x[0, 15] + 3.0, y=log.y[0, 15] + 4.0, speed=12.0, yaw=0.25)
    now = DivergedNow.at(log, opened(1).joined(opened(2)), table, np.array([5, 21]))
    assert now.recorded.tolist() == [True, False], "20 steps into the run no log lags by 21"
    assert (now.log_x[0], now.log_y[0], now.log_speed[0]) == (log.x[0, 15], log.y[0, 15], 10.0)
    residuals = now.residual_position[0], now.residual_speed[0], now.yaw[0] - now.log_yaw[0]
    assert residuals == pytest.approx((5.0, 2.0, 0.25))


def test_a_log_that_is_over_has_no_place(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=50.0, last=12)).log
    table = log.table(12)
    later = replace(table, step=14)
    assert DivergedNow.at(log, opened(2), later, np.zeros(2, np.int64)).recorded.tolist() == [False]
    assert DivergedNow.at(log, opened(2), later, np.array([0, 2])).recorded.tolist() == [True]
