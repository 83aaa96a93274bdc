"""The life cycle of takeovers: step by step by hand, and in closed loop."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from litsim_policy.conflict import takeover as takeover_module
from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.takeover import TakeoverManager
from litsim_predictor.forecast import Predictor
from litsim_predictor.models import make_predictor
from litsim_sim.core.scene import OBSTACLE_KINDS, AgentTable, Controller, Kind
from litsim_sim.core.takeover import Takeover, TakeoverReason, TakeoverState, TakeoverTable
from litsim_sim.scenario.scenario import Scenario

HELD, HANDBACK, RELEASED, OWN_INTENT = TakeoverState
FIRST = 3  # first step after the history of the scenarios here
LENGTH = 4.5  # [m] of everybody


@dataclass
class Stage:
    """The predictor and the conflict stage, fed with tables that are the log but for what the test puts elsewhere."""

    scenario: Scenario
    placed: Callable[..., AgentTable]
    manager: TakeoverManager
    predictor: Predictor
    step: int = FIRST

    def see(self, changes: dict[int, dict[str, float]], step: int | None = None) -> TakeoverTable:
        """The answer to the next step (or to `step`)."""
        self.step = self.step if step is None else step
        table = self.scenario.log.table(self.step)
        for agent, values in changes.items():
            table = self.placed(table, agent, **values)
        answer = self.manager.update(table, self.predictor.forecast(table))
        assert answer.step == self.step
        self.step += 1
        return answer

    def logged(self, agent: int, field: str = "x") -> float:
        """Value of the log at the next step."""
        table = self.scenario.log.table(self.step)
        return float(getattr(table, field)[table.row(agent)])

    def slow_ego(self, behind: int, seconds: float) -> dict[int, dict[str, float]]:
        """Puts the ego, at 4 m/s, where the log of `behind`, at 10 m/s, touches it in `seconds`."""
        return {1: {"x": self.logged(behind) + LENGTH + 6.0 * seconds - 0.01, "speed": 4.0}}


@pytest.fixture
def stage(make_scenario, track, placed):
    def make(*tracks: Any, history_steps: int = FIRST, **config: Any) -> Stage:
        everybody = tracks or (track(1, x=300.0), track(2, x=60.0))
        scenario = make_scenario(*everybody, history_steps=history_steps, coverage_min=0.0)
        manager = TakeoverManager(scenario, ConflictConfig(**{"handback": "catch_up"} | config))
        return Stage(scenario, placed, manager, make_predictor("kinematic", scenario), history_steps)

    return make


def only(answer: TakeoverTable) -> Takeover:
    (takeover,) = answer.takeovers
    return takeover


# Opening


def test_nothing_happens_without_a_conflict(stage) -> None:
    s = stage()
    for _ in range(10):
        answer = s.see({})
        assert answer.takeovers == () and answer.converged and answer.iterations == 1


def test_nothing_happens_before_the_history_is_over(stage) -> None:
    s = stage(history_steps=10)
    for step in range(10):
        s.step = step
        answer = s.see(s.slow_ego(2, 0.5))
        assert answer.takeovers == () and answer.iterations == 0 and answer.converged
    assert only(s.see(s.slow_ego(2, 0.5))).detected_step == 10


def test_a_conflict_that_lies_ahead_is_believed_after_three_steps(stage) -> None:
    s = stage()
    assert s.see(s.slow_ego(2, 2.0)).takeovers == ()
    assert s.see(s.slow_ego(2, 2.0)).takeovers == ()
    takeover = only(s.see(s.slow_ego(2, 2.0)))
    assert (takeover.agent, takeover.opponent) == (2, 1)
    assert (takeover.state, takeover.reason, takeover.detected_step) == (
        HELD,
        TakeoverReason.CONFLICT,
        FIRST + 2,
    )


def test_a_conflict_that_comes_and_goes_is_not_believed(stage) -> None:
    s = stage()
    for _ in range(4):
        assert s.see(s.slow_ego(2, 2.0)).takeovers == ()
        assert s.see(s.slow_ego(2, 2.0)).takeovers == ()
        assert s.see({}).takeovers == ()


@pytest.mark.parametrize(("seconds", "at_once"), [(0.9, True), (1.3, False)])
def test_an_urgent_conflict_is_believed_at_once(stage, seconds: float, at_once: bool) -> None:
    s = stage()
    assert bool(s.see(s.slow_ego(2, seconds)).takeovers) == at_once


def test_how_long_is_waited_and_what_is_urgent_can_be_chosen(stage) -> None:
    s = stage(confirm_steps=1)
    assert len(s.see(s.slow_ego(2, 2.0)).takeovers) == 1
    s = stage(urgent_time=2.5)
    assert len(s.see(s.slow_ego(2, 2.0)).takeovers) == 1


def test_a_takeover_says_what_was_predicted(stage) -> None:
    s = stage(confirm_steps=1)
    x, y = s.logged(2), s.logged(2, "y")
    takeover = only(s.see(s.slow_ego(2, 2.0)))
    assert takeover.time_to_conflict == pytest.approx(1.9), "a step before the forecast is centred on a touch"
    assert takeover.conflict_pose == pytest.approx([x + 19.0, y, 0.0])
    assert takeover.goal_pose == pytest.approx(takeover.conflict_pose)
    assert 0.2 < takeover.overlap_probability < 0.9, "the boxes just touch where the forecast is centred"
    assert takeover.log_collision_predicted
    assert (takeover.residual_position, takeover.residual_speed) == (0.0, 0.0)
    path = takeover.reference_path
    assert path[0] == pytest.approx([x, y]) and path[-1, 0] > x + 100.0
    assert path[:, 1] == pytest.approx(np.full(len(path), y), abs=0.01)


# Chains


def queue_of(stage, track, **config: Any) -> tuple[Stage, dict[int, dict[str, float]]]:
    """Agents 2, 3, 4 behind a standing ego, each about to run into the one before it, which has slowed down."""
    s = stage(track(1, x=300.0), track(2, x=90.0), track(3, x=79.5), track(4, x=69.0), **config)
    changes = {1: {"x": s.logged(2) + 10.0, "speed": 0.0}, 2: {"speed": 2.0}, 3: {"speed": 2.0}}
    return s, changes


def test_a_chain_of_conflicts_is_resolved_within_the_step(stage, track) -> None:
    s, changes = queue_of(stage, track)
    answer = s.see(changes)
    assert [(t.agent, t.opponent) for t in answer.takeovers] == [(2, 1), (3, 2), (4, 3)]
    assert answer.iterations == 4 and answer.converged, "the last round finds nothing new"


@pytest.mark.parametrize(
    ("iterations", "taken", "converged"), [(1, [2], False), (3, [2, 3, 4], False), (4, [2, 3, 4], True)]
)
def test_a_bound_on_the_iterations_is_kept_and_said(
    stage, track, monkeypatch, iterations: int, taken: list[int], converged: bool
) -> None:
    """Those left out come at the next step."""
    monkeypatch.setattr(takeover_module, "ITERATIONS_MAX", iterations)
    s, changes = queue_of(stage, track)
    answer = s.see(changes)
    assert [t.agent for t in answer.takeovers] == taken
    assert (answer.iterations, answer.converged) == (iterations, converged)
    changes[1]["x"] += 0.5
    assert [t.agent for t in s.see(changes).takeovers] == ([2, 3] if iterations == 1 else [2, 3, 4])


def test_with_the_region_around_the_ego_alone_a_chain_ends_at_its_edge(stage, track) -> None:
    s, changes = queue_of(stage, track, region="ego")
    assert [t.agent for t in s.see(changes).takeovers] == [2, 3], "4 is 31 m from the ego, and 10.5 m from 3"


def test_a_radius_of_its_own_is_in_place_of_the_scenario_s(stage, track) -> None:
    s, changes = queue_of(stage, track, region="ego", roi_m=15.0)
    assert [t.agent for t in s.see(changes).takeovers] == [2]


def test_background_is_not_compared_with_background_on_its_log(stage, track) -> None:
    """What the recording itself contains is not ours to mend."""
    s = stage(track(1, x=300.0), track(2, x=90.0, speed=4.0), track(3, x=79.0, speed=14.0, last=30))
    for _ in range(5):
        assert s.see({1: {"x": 95.0, "y": -1.83}}).takeovers == ()


# Holding and handing back


def opened(stage, *tracks: Any, **config: Any) -> tuple[Stage, float]:
    """Agent 2 is HELD for a goal 9 m ahead; from now on the ego is far away. Returns where agent 2 was."""
    s = stage(*tracks, **config)
    x = s.logged(2)
    assert only(s.see(s.slow_ego(2, 0.9))).state == HELD
    return s, x


def test_a_conflict_of_its_log_makes_it_wait_anew(stage) -> None:
    s, x = opened(stage, clear_steps=3)
    held = {"x": x, "controller": Controller.POLICY}
    states = []
    for k in range(12):
        again = k == 4
        takeover = only(s.see((s.slow_ego(2, 1.0) if again else {}) | {2: held}))
        assert takeover.log_collision_predicted == again
        states.append(takeover.state)
    assert states == [HELD] * 10 + [HANDBACK] * 2


def test_a_conflict_on_the_way_back_stops_it(stage) -> None:
    s, x = opened(stage)
    held = {2: {"x": x + 11.0, "controller": Controller.POLICY}}
    states = [only(s.see(held)).state for _ in range(6)]
    assert states[-1] == HANDBACK
    assert only(s.see(s.slow_ego(2, 1.5) | held)).state == HELD


def test_an_agent_that_was_released_can_be_taken_over_again(stage) -> None:
    s, x = opened(stage)
    away = {2: {"x": x + 20.0, "controller": Controller.POLICY}}
    while only(s.see(away)).state == HELD:
        pass
    assert only(s.see({2: {"controller": Controller.POLICY}})).state == RELEASED
    assert s.see({}).takeovers == ()
    again = s.step
    assert only(s.see(s.slow_ego(2, 0.8))).detected_step == again


def test_while_its_log_is_over_an_agent_stays_held_near_the_ego(stage, track) -> None:
    s, _ = opened(stage, track(1, x=300.0), track(2, x=60.0, last=20))
    table = s.scenario.log.table(20)
    off = {"x": 70.0, "controller": Controller.POLICY}
    while s.step <= 20:
        s.see({2: off})
    log = s.scenario.log
    for step in range(21, 40):
        both = log.table(20).take(np.array([True, True]))
        both = AgentTable(step, *(getattr(both, f) for f in both.__dataclass_fields__ if f != "step"))
        both = s.placed(s.placed(both, 2, **off), 1, x=90.0)
        takeover = only(s.manager.update(both, s.predictor.forecast(both)))
        assert takeover.state == HELD
        assert (takeover.residual_position, takeover.residual_speed) == (-1.0, 0.0)
    assert len(table) == 2


def test_one_that_has_left_the_road_is_forgotten(stage, track) -> None:
    s, _ = opened(stage, track(1, x=300.0), track(2, x=60.0, last=20))
    assert s.see({}, step=30).takeovers == ()


# In closed loop


def braking(until: int, to: float, back: bool) -> Callable[[AgentTable, int], tuple[float, float]]:
    """Brakes at 3 m/s2 down to a speed; from step `until` on, if `back`, it returns to a log of 10 m/s from x = 100."""

    def drive(table: AgentTable, row: int) -> tuple[float, float]:
        speed, lag = float(table.speed[row]), 100.0 + table.step - float(table.x[row])
        if back and table.step >= until:
            return float(np.clip(0.36 * lag + 1.2 * (10.0 - speed), -2.0, 2.0)), 0.0
        return (-3.0 if speed > to + 0.3 else 10.0 * (to - speed)), 0.0

    return drive


def test_an_agent_yields_and_comes_back_to_its_log(make_scenario, track, drive) -> None:
    scenario = make_scenario(track(1, x=100.0, last=300), track(2, x=85.0, last=300))
    run = drive(scenario, braking(until=20, to=6.0, back=True), parameters={"conflict": {"handback": "catch_up"}})
    assert run.life(2) == [HELD, OWN_INTENT, HANDBACK, RELEASED]
    assert run.world.contacts == {}
    steps = sorted(run.takeovers(2))
    assert steps == list(range(steps[0], steps[-1] + 1))
    controllers = run.series(2, "controller")
    # the answer to a step moves the agent to the next one; RELEASED is no longer driven
    assert (controllers[steps[0] + 1 : steps[-1] + 1] == Controller.POLICY).all()
    assert (controllers[: steps[0] + 1] == Controller.LOG).all() and (controllers[steps[-1] + 1 :] == 0).all()
    assert run.from_log(2, steps[0] + 15) > 1.0
    assert all(run.from_log(2, step) < 1e-9 for step in range(steps[-1] + 60, scenario.total_steps))


def test_a_queue_forms_behind_an_ego_that_slows_down(make_scenario, track, drive) -> None:
    scenario = make_scenario(*(track(i, x=115.0 - 15.0 * i, last=100) for i in range(1, 6)))
    run = drive(scenario, braking(until=0, to=2.0, back=False))
    assert run.world.contacts == {}
    opponents = [next(iter(run.takeovers(i).values())).opponent for i in range(2, 6)]
    assert opponents[0] == 1 and all(opponent < i for i, opponent in zip(range(2, 6), opponents, strict=True))
    detected = [min(run.takeovers(i)) for i in range(2, 6)]
    assert detected == sorted(detected)
    replay = drive(scenario, braking(until=0, to=2.0, back=False), policy="replay")
    assert len(replay.world.contacts) == 4, "each of them would have driven through the ego"


def test_an_entry_where_the_ego_stands_is_late_and_adopted(make_scenario, track, drive) -> None:
    def stop_and_go(table: AgentTable, row: int) -> tuple[float, float]:
        return (-6.0 if table.step < 40 else 2.0), 0.0

    scenario = make_scenario(track(1, x=150.0, last=200), track(3, x=160.0, first=20, last=200))
    run = drive(scenario, stop_and_go)
    first = run.takeovers(3)[min(run.takeovers(3))]
    assert run.world.entries.late == {3} and run.world.contacts == {}
    assert (first.reason, first.opponent, first.state) == (TakeoverReason.BLOCKED_ENTRY, 1, HELD)
    assert first.detected_step > 40 and first.overlap_probability == 1.0
    on_time = drive(scenario, "log")
    assert on_time.world.entries.late == set() and on_time.takeovers(3) == {}


# Hand-back to a log that is late


@pytest.fixture
def lag_then_go(make_scenario, track, drive) -> Callable[..., Any]:
    """The ego brakes from 10 to 5 m/s and drives on at 10 m/s, 12 m behind its log; agents 2 and 3 are behind it."""

    def drive_it(table: AgentTable, row: int) -> tuple[float, float]:
        braking = table.step < FIRST + 20
        return (-2.5 if braking else min(2.0, 2.0 * (10.0 - float(table.speed[row])))), 0.0

    def run(handback: str, *others: Any) -> Any:
        scenario = make_scenario(*(track(i, x=115.0 - 16.0 * i, last=200) for i in (1, 2, 3)), *others)
        return drive(scenario, drive_it, parameters={"conflict": {"handback": handback}})

    return run


def test_behind_an_ego_that_stays_behind_only_a_late_log_can_be_rejoined(lag_then_go) -> None:
    assert RELEASED not in lag_then_go("catch_up").life(2)
    late = lag_then_go("time_shift")
    assert late.life(2) == [HELD, OWN_INTENT, HANDBACK, RELEASED] and late.world.contacts == {}


def test_from_the_release_on_the_log_is_replayed_with_the_lag_that_was_recorded(lag_then_go) -> None:
    run = lag_then_go("time_shift")
    records = run.takeovers(2)
    released = max(records)
    lag = round(records[released].time_shift / 0.1)
    assert records[released].state == RELEASED and lag > 5
    assert records[released].residual_position <= 0.5, "from the late log, as the release measures it"
    table, log = run.results[released].table, run.scenario.log.table(released - lag)
    row, logged = table.row(2), log.row(2)
    assert records[released].residual_position == np.hypot(table.x[row] - log.x[logged], table.y[row] - log.y[logged])
    assert records[released].residual_speed == table.speed[row] - log.speed[logged]
    for step in range(released + 60, 201):
        table, log = run.results[step].table, run.scenario.log.table(step - lag)
        row, logged = table.row(2), log.row(2)
        assert table.controller[row] == Controller.LOG
        assert (table.x[row], table.y[row]) == pytest.approx((log.x[logged], log.y[logged]), abs=1e-9)


def test_a_log_that_is_late_is_what_conflicts_are_looked_for_with(stage) -> None:
    """Agent 2 follows its log 15 m late; the ego stands where only the log without the lag would touch it."""
    s = stage(handback="time_shift", history_steps=20)
    s.manager._lag[1] = 15
    late = {2: {"x": s.logged(2) - 15.0}}
    assert s.see({1: {"x": s.logged(2) + LENGTH + 18.0, "speed": 0.0}} | late).takeovers == ()
    answer = s.see({1: {"x": s.logged(2) - 15.0 + LENGTH + 9.0, "speed": 0.0}} | {2: {"x": s.logged(2) - 15.0}})
    assert [t.agent for t in answer.takeovers] == [2]


def test_who_follows_a_late_log_is_somebody_to_look_out_for(stage, track) -> None:
    """Both touch; here is looked at the first takeover, of the one behind."""
    tracks = track(1, x=300.0), track(2, x=90.0), track(3, x=78.0)
    s = stage(*tracks, handback="time_shift", history_steps=20, closing_time=0.0)
    assert s.see({2: {"x": s.logged(2) - 6.0}}).takeovers == (), "on its log, whatever it is: theirs to sort out"
    s.manager._lag[1] = 6
    answers = [s.see({2: {"x": s.logged(2) - 9.0}}) for _ in range(3)]
    answer = next(each for each in answers if each.takeovers)
    assert [(t.agent, t.opponent) for t in answer.takeovers] == [(3, 2)]


def test_who_follows_a_late_log_does_not_run_into_who_is_ahead_of_it_by_now(stage, track) -> None:
    """In the log, agent 2 is ahead of agent 3, which is slower; 25 m late, it is behind, and knows nothing of it."""
    tracks = track(1, x=300.0), track(2, x=90.0), track(3, x=75.0, speed=8.0)
    s = stage(*tracks, handback="time_shift", history_steps=20)
    assert s.see({}).takeovers == ()
    s.manager._lag[1] = 25
    answers = [s.see({2: {"x": s.logged(2) - 25.0}}) for _ in range(3)]
    answer = next(each for each in answers if each.takeovers)
    assert [(t.agent, t.opponent) for t in answer.takeovers] == [(2, 3)]


# Pedestrians and cyclists


@pytest.fixture
def runner(track) -> Any:
    """Runs across lane 2 at x 200 m, between the logs of agents 2 and 3 of `lag_then_go`."""

    def make(kind: Kind) -> Any:
        size = {"length": 0.5, "width": 0.5}
        return track(4, x=200.0, y=-40.5, yaw=0.5 * np.pi, speed=2.8, last=200, kind=kind, **size)

    return make


@pytest.mark.parametrize("kind", [Kind.CAR, Kind.BICYCLE, Kind.PEDESTRIAN])
def test_pedestrians_and_cyclists_are_never_taken_over(stage, track, runner, kind: Kind) -> None:
    s = stage(track(1, x=100.0, last=200), runner(kind))
    taken = []
    for step in range(100, 125):  # the ego stands where agent 4 is about to run
        taken += [t.agent for t in s.see({1: {"x": 200.0, "speed": 0.0}}, step).takeovers]
    assert set(taken) == (set() if kind in OBSTACLE_KINDS else {4})


def test_who_follows_a_late_log_yields_to_a_pedestrian_on_his(lag_then_go, runner) -> None:
    run = lag_then_go("time_shift", runner(Kind.PEDESTRIAN))
    taken = run.takeovers(2)
    assert {t.opponent for t in taken.values()} == {1, 4}, "first to the ego, then to whoever runs across"
    assert run.world.contacts == {} and not run.takeovers(4)
    np.testing.assert_array_equal(run.series(4, "controller"), Controller.LOG)
    np.testing.assert_array_equal(run.series(4, "y"), run.scenario.log.y[run.scenario.log.row(4)])


# Provenance


def test_with_the_ego_on_its_log_nobody_is_taken_over(make_scenario, track, drive, lane_centres) -> None:
    tracks = [track(1 + i, x=100.0 - 12.0 * (i // 3), y=lane_centres[i % 3], last=150) for i in range(12)]
    run = drive(make_scenario(*tracks), "log")
    assert all(r.takeovers.takeovers == () for r in run.results)
