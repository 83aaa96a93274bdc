"""Distances to the log, on offsets that are known."""

from typing import Any

import pytest

from litsim_eval.analysis.measures.displacement import displacements
from litsim_sim.core.scene import Controller
from made_runs import make_run, moved, table

HISTORY = 30


def log_of(steps: int) -> list[Any]:
    """Ego 1 and agents 2 and 3, 10 m/s."""
    return [table(k, *({"id": a, "x": 1.0 * k, "y": 10.0 * a} for a in (1, 2, 3))) for k in range(steps + 1)]


def test_ade_of_a_constant_offset() -> None:
    log = log_of(HISTORY + 100)
    run = [t if t.step <= HISTORY else moved([t], 2, x=3.0, y=4.0, controller=Controller.POLICY)[0] for t in log]
    far = displacements(make_run(run, log, history_steps=HISTORY))
    assert far.horizons == (5, 10)
    assert far.ade_controlled(5) == pytest.approx(5.0)
    assert far.ade_all(5) == pytest.approx(2.5)  # the ego is no part of it
    assert far.ade_ego(10) == 0.0


def test_ade_counts_up_to_the_horizon_from_the_end_of_the_history() -> None:
    log = log_of(HISTORY + 100)
    late = HISTORY + 51
    run = [t if t.step < late else moved([t], 2, y=2.0, controller=Controller.POLICY)[0] for t in log]
    far = displacements(make_run(run, log, history_steps=HISTORY))
    assert far.ade_all(5) == 0.0
    assert far.ade_controlled(5) is None  # nobody was under control yet
    assert far.ade_controlled(10) == pytest.approx(1.0)
    assert far.ade_all(10) == pytest.approx(0.5)


def test_ego_is_measured_apart() -> None:
    log = log_of(HISTORY + 50)
    far = displacements(make_run(moved(log, 1, x=-2.0, controller=Controller.EGO), log, history_steps=HISTORY))
    assert far.ade_ego(5) == pytest.approx(2.0)
    assert far.ade_all(5) == 0.0
    assert far.ade_controlled(5) is None


@pytest.mark.parametrize(("steps", "horizons"), [(49, ()), (50, (5,)), (250, (5, 10, 15, 20, 25))])
def test_only_horizons_that_are_reached(steps: int, horizons: tuple[int, ...]) -> None:
    log = log_of(HISTORY + steps)
    assert displacements(make_run(log, history_steps=HISTORY)).horizons == horizons


def test_agents_without_a_logged_pose_do_not_count() -> None:
    log = log_of(50)
    gone = [t.take(t.id != 3) for t in log]
    far = displacements(make_run(log, gone))
    assert set(far.id.tolist()) == {1, 2}
    assert far.ade_all(5) == 0.0


def test_replay_error_is_that_of_agents_never_under_control() -> None:
    log = log_of(10)
    run = moved(moved(log, 2, y=5.0, controller=Controller.POLICY), 3, x=0.25)
    assert displacements(make_run(run, log)).replay_error() == pytest.approx({3: 0.25})
    assert displacements(make_run(log)).replay_error() == {2: 0.0, 3: 0.0}


def test_without_a_log_there_is_nothing() -> None:
    far = displacements(make_run(log_of(50), []))
    assert far.ade_all(5) is None
    assert far.replay_error() == {}


def test_who_is_held_back_waits_at_the_first_pose_of_its_log() -> None:
    log = [table(k, {"id": 1, "x": 0.0, "y": 0.0}, *_entering(k, 2)) for k in range(HISTORY + 51)]
    held = [t.take(t.id != 2) if t.step < HISTORY + 41 else t for t in log]
    far = displacements(make_run(held, log, history_steps=HISTORY))
    assert far.ade_all(5) == pytest.approx(sum(range(30)) / 40)  # 1 m a step from where it begins, for 30 of 40 steps
    assert far.replay_error() == {2: 0.0}  # while it is on the road


def test_who_has_left_before_its_log_stays_where_it_was() -> None:
    log = log_of(HISTORY + 50)
    gone = [t if t.step <= HISTORY + 25 else t.take(t.id != 2) for t in log]
    far = displacements(make_run(gone, log, history_steps=HISTORY))
    (left,) = far.by_agent()
    assert (left["agent"], left["controlled_s"], left["steps"]) == (2, None, {"5": 50})
    assert left["ade_m"]["5"] == pytest.approx(sum(range(1, 26)) / 50)
    assert far.agent_steps(5) == 100  # both, whether or not the run has them


def test_agents_apart_are_those_off_their_logs() -> None:
    log = log_of(HISTORY + 100)
    late = HISTORY + 61
    run = [t if t.step < late else moved([t], 3, y=1.0, controller=Controller.POLICY)[0] for t in log]
    (only,) = displacements(make_run(run, log, history_steps=HISTORY)).by_agent()
    assert (only["agent"], only["controlled_s"], only["steps"]) == (3, 6.1, {"5": 50, "10": 100})
    assert only["ade_m"] == {"5": 0.0, "10": pytest.approx(0.4)}


def _entering(k: int, agent: int) -> list[dict[str, float]]:
    """An agent whose log begins 11 steps after the history, 1 m a step."""
    return [{"id": agent, "x": 50.0 + (k - HISTORY - 11), "y": 9.0}] if k >= HISTORY + 11 else []
