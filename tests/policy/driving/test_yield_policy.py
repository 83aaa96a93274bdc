"""The rule-based policy: it yields, it stays on the road, it comes back."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from litsim_policy.driving.handback import ACCELERATION_MAX, COMFORTABLE, DECELERATION_MAX, SPEED_EXCESS
from litsim_policy.driving.yield_policy import YieldPolicy
from litsim_policy.driving.yielding_rules import COURTESY_DECELERATION
from litsim_policy.motion.reference_path import logged_path
from litsim_sim.core.scene import AgentTable, ControlSource, ControlTable, EgoCommand, EgoMode
from litsim_sim.core.takeover import TakeoverState, TakeoverTable
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.world import World
from made_agents import takeover


@dataclass(frozen=True)
class Takeovers:
    """Makes takeovers of agents of a scenario, whatever the conflict stage would say."""

    scenario: Scenario

    def table(self, step: int, agents: dict[int, int], state: TakeoverState = TakeoverState.HELD) -> TakeoverTable:
        """Takeovers at a step, of agents with their opponents."""
        made = []
        for agent, opponent in sorted(agents.items()):
            path = logged_path(self.scenario.log, self.scenario.lane_map, agent).points
            made.append(takeover(agent, opponent, state=state, reference_path=path))
        return TakeoverTable(step, tuple(made))


def make(scenario: Scenario) -> tuple[YieldPolicy, Takeovers]:
    return YieldPolicy(scenario), Takeovers(scenario)


def one(controls: ControlTable) -> tuple[float, float]:
    """Acceleration and yaw rate of the only agent."""
    assert len(controls.id) == 1
    return float(controls.acceleration[0]), float(controls.yaw_rate[0])


def simulate(
    scenario: Scenario,
    start: dict[int, dict[str, float]],
    agents: dict[int, int],
    state: TakeoverState,
    steps: int,
    placed: Callable,
) -> list[AgentTable]:
    """Agents driven by the policy from where `start` puts them, the others on their logs."""
    policy, takeovers = make(scenario)
    world = World(scenario)
    table = world.reset()
    for agent, values in start.items():
        table = placed(table, agent, **values)
    world._table = table
    tables = [table]
    for _ in range(steps):
        controls = policy.act(table, takeovers.table(table.step, agents, state))
        table = world.step(controls, EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG))
        tables.append(table)
    return tables


def series(tables: list[AgentTable], agent: int, field: str) -> np.ndarray:
    return np.array([getattr(t, field)[t.row(agent)] for t in tables])


# What is answered


def test_those_released_and_those_on_their_logs_are_not_driven(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=200.0), track(2, x=60.0), track(3, x=30.0))
    policy, takeovers = make(scenario)
    table = scenario.log.table(5)
    assert len(policy.act(table, TakeoverTable(5)).id) == 0
    assert len(policy.act(table, takeovers.table(5, {2: 1}, TakeoverState.RELEASED)).id) == 0
    mixed = takeovers.table(5, {2: 1}).takeovers + takeovers.table(5, {3: 2}, TakeoverState.HANDBACK).takeovers
    controls = policy.act(table, TakeoverTable(5, mixed))
    assert controls.step == 5 and controls.id.tolist() == [2, 3]
    assert controls.source.tolist() == [ControlSource.POLICY, ControlSource.HANDBACK]
    assert controls.lateral_acceleration == pytest.approx(10.0 * controls.yaw_rate)


# Following


@pytest.mark.parametrize(("speed", "gap", "braking"), [(5.0, 4.0, 8.0), (10.0, 15.0, 8.0), (20.0, 8.0, 6.0)])
def test_it_never_drives_into_an_ego_that_stops_ahead(
    make_scenario, track, drive, speed: float, gap: float, braking: float
) -> None:
    ego, follower = track(1, x=200.0, speed=speed, last=110), track(2, x=195.5 - gap, speed=speed, last=110)
    stays = {"conflict": {"passing": False}}  # in its lane, or it may go round it
    run = drive(make_scenario(ego, follower), lambda *_: (-braking, 0.0), parameters=stays)
    assert run.world.contacts == {}
    left = run.series(1, "x") - run.series(2, "x") - 4.5
    assert left.min() > 0.5
    assert left[-1] < COMFORTABLE.standstill_gap + 0.4 and run.series(2, "speed")[-1] < 0.05


def test_behind_a_standing_ego_it_drives_on_when_the_ego_does(make_scenario, track, drive) -> None:
    scenario = make_scenario(track(1, x=100.0, last=250), track(2, x=85.0, last=250))
    run = drive(scenario, lambda table, _: (-5.0 if table.step < 80 else 2.0, 0.0))
    speed = run.series(2, "speed")
    assert speed[70:80].max() < 0.2
    assert speed[140:200].min() > 6.0 and run.world.contacts == {}


def test_a_courtesy_is_no_emergency(make_scenario, track, placed, lane_centres) -> None:
    """Braking for an opponent in the next lane is bounded; for the same one in the way it is not."""
    scenario = make_scenario(track(1, x=200.0), track(2, x=60.0, speed=15.0))
    policy, takeovers = make(scenario)
    table = scenario.log.table(5)
    x = float(table.x[table.row(2)])
    beside = placed(table, 1, x=x + 8.0, y=lane_centres[0], speed=2.0)
    polite, _ = one(policy.act(beside, takeovers.table(5, {2: 1})))
    assert polite == -COURTESY_DECELERATION
    in_the_way = placed(table, 1, x=x + 8.0, y=lane_centres[1], speed=2.0)
    hard, _ = one(policy.act(in_the_way, takeovers.table(5, {2: 1})))
    assert hard == -COMFORTABLE.braking_max


def test_a_stranger_in_the_next_lane_gets_no_courtesy(make_scenario, track, placed, lane_centres) -> None:
    scenario = make_scenario(track(1, x=200.0), track(2, x=60.0, speed=15.0), track(3, x=300.0))
    policy, takeovers = make(scenario)
    table = scenario.log.table(5)
    beside = placed(table, 3, x=float(table.x[table.row(2)]) + 8.0, y=lane_centres[0], speed=2.0)
    assert one(policy.act(beside, takeovers.table(5, {2: 1})))[0] > 0.0
    behind = placed(table, 1, x=float(table.x[table.row(2)]) - 8.0, y=lane_centres[0], speed=15.0)
    assert one(policy.act(behind, takeovers.table(5, {2: 1})))[0] > 0.0, "nor does an opponent that is behind"


@pytest.mark.parametrize(("logged", "settles_at"), [(8.0, 9.0), (15.0, 16.0), (0.0, 3.0)])
def test_on_a_free_road_it_drives_a_little_faster_than_its_log(
    make_scenario, track, placed, logged: float, settles_at: float
) -> None:
    scenario = make_scenario(track(1, x=400.0, last=150), track(2, x=30.0, speed=logged, last=150))
    speed = series(simulate(scenario, {}, {2: 1}, TakeoverState.HELD, 140, placed), 2, "speed")
    assert speed[-1] == pytest.approx(settles_at, abs=0.1) and speed.max() < settles_at + 0.05


# To the side


def test_it_stays_on_its_logged_path(make_scenario, track, placed) -> None:
    scenario = make_scenario(track(1, x=300.0), track(2, x=60.0, yaw=-0.04))
    tables = simulate(scenario, {2: {"speed": 6.0}}, {2: 1}, TakeoverState.HELD, 50, placed)
    path = logged_path(scenario.log, scenario.lane_map, 2)
    _, offset = path.project(series(tables, 2, "x"), series(tables, 2, "y"))
    assert np.abs(offset).max() < 0.05


def test_a_move_to_the_side_waits_for_whoever_is_alongside(make_scenario, track, placed, lane_centres) -> None:
    scenario = make_scenario(track(1, x=300.0), track(2, x=60.0, y=lane_centres[2] + 0.6, yaw=0.08), track(3, x=200.0))
    policy, takeovers = make(scenario)
    table = scenario.log.table(0)
    x = float(table.x[table.row(2)])
    _, free = one(policy.act(table, takeovers.table(0, {2: 1})))
    _, taken = one(policy.act(placed(table, 3, x=x - 1.0), takeovers.table(0, {2: 1})))
    _, behind = one(policy.act(placed(table, 3, x=x - 12.0), takeovers.table(0, {2: 1})))
    _, closing = one(policy.act(placed(table, 3, x=x - 12.0, speed=17.0), takeovers.table(0, {2: 1})))
    _, other_side = one(policy.act(placed(table, 3, x=x - 1.0, y=lane_centres[2] - 1.8), takeovers.table(0, {2: 1})))
    assert free == pytest.approx(0.0, abs=0.01), "it already heads along its path"
    assert taken < -0.1, "back along the lane"
    assert closing == pytest.approx(taken) and behind == pytest.approx(free) and other_side == pytest.approx(free)


@pytest.mark.parametrize("ahead", [-6.0, -3.0, 0.0, 3.0])
def test_an_ego_alongside_during_its_lane_change_is_never_touched(
    make_scenario, track, drive, lane_centres, ahead: float
) -> None:
    """The ego keeps beside agent 2, which wants into its lane, come what may."""

    def beside(table: AgentTable, row: int) -> tuple[float, float]:
        other = table.row(2)
        apart, faster = table.x[other] + ahead - table.x[row], table.speed[other] - table.speed[row]
        return float(np.clip(0.36 * apart + 1.2 * faster, -3.0, 2.0)), 0.0

    merging = track(2, x=85.0, y=lane_centres[2], yaw=0.05, last=80)
    scenario = make_scenario(track(1, x=110.0, last=150), merging)
    assert set(drive(scenario, beside, policy="replay").world.contacts) == {(1, 2)}
    run = drive(scenario, beside)
    assert run.world.contacts == {} and len(run.takeovers(2)) > 50


def test_a_lane_change_ends_behind_an_ego_that_goes_on(make_scenario, track, drive, lane_centres) -> None:
    merging = track(2, x=85.0, y=lane_centres[2], yaw=0.05, last=80)
    scenario = make_scenario(track(1, x=110.0, last=250), merging)

    def slower(table: AgentTable, row: int) -> tuple[float, float]:
        return float(np.clip(6.0 - table.speed[row], -3.0, 0.0)), 0.0

    assert set(drive(scenario, slower, policy="replay").world.contacts) == {(1, 2)}
    run = drive(scenario, slower, parameters={"conflict": {"passing": False}})
    assert run.world.contacts == {}
    gap = run.series(1, "x")[-1] - run.series(2, "x")[-1] - 4.5
    assert run.series(2, "y")[-1] == pytest.approx(lane_centres[1], abs=0.6)
    assert 4.0 < gap < 12.0 and run.series(2, "speed")[-1] == pytest.approx(6.0, abs=0.2)


# Catching up


@pytest.mark.parametrize(("lag", "left"), [(-12.0, 0.0), (-2.0, 1.5), (0.0, -1.5), (5.0, 1.5), (20.0, 0.0)])
def test_on_the_way_back_it_reaches_its_log_within_comfort(
    make_scenario, track, placed, lane_centres, lag: float, left: float
) -> None:
    scenario = make_scenario(track(1, x=400.0, last=220), track(2, x=60.0, last=220))
    start = {2: {"x": 60.0 - lag, "y": lane_centres[1] + left, "speed": 8.0}}
    tables = simulate(scenario, start, {2: 1}, TakeoverState.HANDBACK, 200, placed)
    apart = np.hypot(
        series(tables, 2, "x") - scenario.log.x[1, : len(tables)],
        series(tables, 2, "y") - scenario.log.y[1, : len(tables)],
    )
    assert apart[150:].max() < 0.3
    assert np.abs(series(tables, 2, "speed")[150:] - 10.0).max() < 0.2
    acceleration = series(tables, 2, "acceleration")[1:]
    assert acceleration.max() <= ACCELERATION_MAX + 1e-9
    assert acceleration.min() >= -DECELERATION_MAX - 1e-9
    assert series(tables, 2, "speed").max() < 10.0 + SPEED_EXCESS + 0.1


def test_on_the_way_back_it_does_not_drive_into_whoever_is_in_the_way(make_scenario, track, placed) -> None:
    slow = track(3, x=70.0, speed=5.0, last=150)
    scenario = make_scenario(track(1, x=400.0, last=150), track(2, x=90.0, last=150), slow)
    tables = simulate(scenario, {2: {"x": 50.0}}, {2: 1}, TakeoverState.HANDBACK, 140, placed)
    gap = series(tables, 3, "x") - series(tables, 2, "x") - 4.5
    assert gap.min() > 1.0 and series(tables, 2, "speed")[-1] == pytest.approx(5.0, abs=0.3)


@pytest.mark.parametrize(
    ("gap", "ahead", "least"),
    [
        (6.0, {"speed": 10.0}, 2.5),  # as fast: the gap is shorter than it likes, and no more
        (6.0, {"speed": 4.0}, 6.0**2 / (2.0 * 6.0)),  # closing in
        (6.0, {"speed": 10.0, "acceleration": -5.0}, 10.0**2 / (2.0 * (6.0 + 100.0 / 10.0))),  # about to stop
    ],
)
def test_on_the_way_back_it_brakes_no_harder_than_it_has_to(
    make_scenario, track, placed, gap: float, ahead: dict[str, float], least: float
) -> None:
    """The car following alone would have it brake by 3.2 m/s2 and more."""
    scenario = make_scenario(track(1, x=400.0), track(2, x=60.0), track(3, x=64.5 + gap, last=12, **ahead))
    tables = simulate(scenario, {2: {"x": 60.0}}, {2: 1}, TakeoverState.HANDBACK, 1, placed)
    assert series(tables, 2, "acceleration")[1] == pytest.approx(-least, abs=0.01)


# Who gives way to whom


@pytest.mark.parametrize("ahead", [-3.0, -1.0, 1.0, 3.0])
def test_of_two_that_change_places_one_lets_the_other_go_first(
    make_scenario, track, placed, lane_centres, ahead: float
) -> None:
    middle = 0.5 * (lane_centres[1] + lane_centres[2])
    upper = track(2, x=60.0, y=middle + 1.5, yaw=-0.05, last=130)
    lower = track(3, x=60.0 + ahead, y=middle - 1.5, yaw=0.05, last=130)
    scenario = make_scenario(track(1, x=400.0, last=130), upper, lower)
    tables = simulate(scenario, {}, {2: 1, 3: 2}, TakeoverState.HELD, 120, placed)
    for agent in (2, 3):
        assert series(tables, agent, "speed")[-1] > 9.0
    beside = np.abs(series(tables, 2, "x") - series(tables, 3, "x")) < 4.5
    apart = np.abs(series(tables, 2, "y") - series(tables, 3, "y"))
    assert (apart[beside] > 2.0).all()
