"""Actors: agents do what the changes of a scenario say, whatever the policy wants, and are the policy's afterwards."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.scene import AgentTable, Controller, ControlSource, ControlTable, EgoCommand, Kind
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.world.world import World

EGO, LEADER, BESIDE, LATE, WALKER = 1, 2, 3, 4, 5
BEGIN = 10
BRAKE = {"kind": "brake", "agent": LEADER, "begin_s": 1.0, "duration_s": 2.0, "deceleration": 3.0}
CUT_IN = {"kind": "cut_in", "agent": BESIDE, "begin_s": 1.0, "duration_s": 2.0}
CROSS = {"kind": "cross", "agent": WALKER, "begin_s": 1.0, "speed": 1.4}
PACE = {"kind": "pace", "agent": LEADER, "begin_s": 1.0, "duration_s": 4.0, "factor": 0.6}


@pytest.fixture(scope="module")
def scenario(make_scenario, track, lane_centres) -> Callable[..., Any]:
    tracks = (
        track(EGO, x=100.0),
        track(LEADER, x=140.0),
        track(BESIDE, x=115.0, y=lane_centres[2]),
        track(LATE, x=60.0, first=20),
        track(WALKER, x=170.0, y=lane_centres[1] - 7.0, yaw=np.pi / 2, speed=0.0, length=0.6, kind=Kind.PEDESTRIAN),
    )
    return lambda *changes: make_scenario(*tracks, changes=list(changes))


def run(world: World, commands: Callable[[AgentTable], ControlTable] | None = None) -> list[AgentTable]:
    """Returns the steps of a run in which the ego keeps its speed."""
    tables = [world.reset()]
    while tables[-1].step < world.scenario.total_steps:
        step = tables[-1].step
        controls = ControlTable.empty(step) if commands is None else commands(tables[-1])
        tables.append(world.step(controls, EgoCommand(step)))
    return tables


def column(tables: list[AgentTable], agent: int, name: str) -> np.ndarray:
    return np.array([getattr(table, name)[table.row(agent)] for table in tables if table.row(agent) >= 0])


def test_brakes_and_returns_to_its_log(scenario) -> None:
    tables = run(World(scenario(BRAKE), guard_entries=False))
    speed, controller = (column(tables, LEADER, name) for name in ("speed", "controller"))
    np.testing.assert_allclose(speed[BEGIN : BEGIN + 21], 10.0 - 0.3 * np.arange(21), atol=1e-9)
    acting = (controller == Controller.POLICY).nonzero()[0]
    assert acting.tolist() == list(range(BEGIN + 1, BEGIN + 21))
    assert column(tables, LEADER, "x")[-1] > 150.0
    assert (column(tables, BESIDE, "controller") == Controller.LOG).all()


def test_cuts_in_on_the_side_of_the_ego(scenario, lane_centres) -> None:
    y = column(run(World(scenario(CUT_IN), guard_entries=False)), BESIDE, "y")
    assert y[BEGIN] == pytest.approx(lane_centres[2])
    assert y[BEGIN + 10] == pytest.approx(0.5 * (lane_centres[1] + lane_centres[2]), abs=1.2)
    assert y[BEGIN + 35] == pytest.approx(lane_centres[1], abs=0.2)


def test_cuts_out_to_the_left(scenario, lane_centres) -> None:
    cut_out = CUT_IN | {"kind": "cut_out", "agent": LEADER}
    y = column(run(World(scenario(cut_out), guard_entries=False)), LEADER, "y")
    assert y[BEGIN] == pytest.approx(lane_centres[1])
    assert y[BEGIN + 35] == pytest.approx(lane_centres[0], abs=0.2)


def test_an_inattentive_driver_brakes_later(scenario) -> None:
    def braking(table: AgentTable) -> ControlTable:
        if table.step < BEGIN:
            return ControlTable.empty(table.step)
        brake = -2.0 if table.step < BEGIN + 20 else 0.0
        one = np.ones(1)
        source = np.full(1, ControlSource.POLICY, np.uint8)
        return ControlTable(table.step, np.array([LEADER]), brake * one, 0 * one, 0 * one, source)

    late = {"kind": "inattentive", "agent": LEADER, "later_s": 0.5}
    usual, delayed = (
        column(run(World(each), braking), LEADER, "acceleration") for each in (scenario(), scenario(late))
    )
    assert usual[BEGIN + 1] == pytest.approx(-2.0)
    np.testing.assert_allclose(delayed[BEGIN + 6 : BEGIN + 30], usual[BEGIN + 1 : BEGIN + 25], atol=1e-9)
    np.testing.assert_allclose(delayed[BEGIN + 1 : BEGIN + 6], 0.0, atol=1e-9)


def closing_in(scenario: Any, by: float) -> list[AgentTable]:
    """Returns the steps of a run in which the ego accelerates by `by` [m/s2], up to 15 m/s."""
    world = World(scenario, guard_entries=False)
    tables = [world.reset()]
    while tables[-1].step < scenario.total_steps:
        step, speed = tables[-1].step, tables[-1].speed[tables[-1].row(EGO)]
        tables.append(world.step(ControlTable.empty(step), EgoCommand(step, by if speed < 15.0 else 0.0)))
    return tables


@pytest.mark.parametrize(
    "change",
    [BRAKE | {"headway_s": [0.0, 2.5]}, CUT_IN | {"headway_s": [0.3, 0.8]}, CROSS | {"headway_s": [0.0, 4.0]}],
)
def test_waits_until_the_ego_is_near_enough(scenario, change: dict[str, Any]) -> None:
    (least, greatest), agent = change["headway_s"], change["agent"]
    begins = []
    for by in (0.0, 0.5, 1.5):
        tables = closing_in(scenario(change), by)
        acting = [table.step for table in tables if table.controller[table.row(agent)] == Controller.POLICY]
        if not acting:
            continue
        table = tables[acting[0] - 1]
        own, other = table.row(EGO), table.row(agent)
        room = table.x[other] - table.x[own] - 0.5 * (table.length[own] + table.length[other])
        assert least <= room / table.speed[own] <= greatest and table.step >= BEGIN
        begins.append(table.step)
    assert len({*begins}) == len(begins) >= 2  # where the ego is, not when


def test_stays_on_its_log_where_the_ego_never_comes_near(scenario) -> None:
    tables = run(World(scenario(BRAKE | {"headway_s": [0.0, 1.0]}), guard_entries=False))
    assert (column(tables, LEADER, "controller") == Controller.LOG).all()


def test_a_pedestrian_crosses_until_the_run_ends(scenario) -> None:
    tables = run(World(scenario(CROSS), guard_entries=False))
    y, speed = column(tables, WALKER, "y"), column(tables, WALKER, "speed")
    np.testing.assert_allclose(y[: BEGIN + 1], y[0])
    np.testing.assert_allclose(speed[BEGIN + 8 :], 1.4, atol=1e-9)
    np.testing.assert_allclose(np.abs(np.diff(y[BEGIN + 8 :])), 0.14, atol=1e-9)


def test_drives_at_another_pace(scenario) -> None:
    tables = run(World(scenario(PACE), guard_entries=False))
    assert column(tables, LEADER, "speed")[BEGIN + 40] == pytest.approx(6.0, abs=0.2)
    np.testing.assert_allclose(column(tables, LEADER, "y"), column(tables, LEADER, "y")[0], atol=1e-6)


def test_enters_earlier_off_its_log(scenario) -> None:
    tables = run(World(scenario({"kind": "enter", "agent": LATE, "later_s": -0.8}), guard_entries=False))
    first = next(table.step for table in tables if table.row(LATE) >= 0)
    assert first == 12
    assert (column(tables, LATE, "controller")[2:] == Controller.POLICY).all()
    np.testing.assert_allclose(column(tables, LATE, "speed"), 10.0, atol=1e-9)


def test_overrules_the_policy_while_it_acts(scenario) -> None:
    def accelerating(table: AgentTable) -> ControlTable:
        one = np.ones(2)
        ids = np.array([LEADER, BESIDE])
        return ControlTable(table.step, ids, one, 0 * one, 0 * one, np.full(2, ControlSource.POLICY, np.uint8))

    tables = run(World(scenario(BRAKE)), accelerating)
    acceleration = column(tables, LEADER, "acceleration")
    assert (acceleration[BEGIN + 1 : BEGIN + 21] == pytest.approx(-3.0)) and acceleration[BEGIN + 22] == pytest.approx(
        1.0
    )
    assert column(tables, BESIDE, "acceleration")[BEGIN + 5] == pytest.approx(1.0)


def test_batched_scenes_have_actors_of_their_own(scenario) -> None:
    waits = CROSS | {"headway_s": [0.0, 4.0]}
    scenarios = [scenario(BRAKE), scenario(CUT_IN), scenario(), scenario(waits)]
    alone = [run(World(each, guard_entries=False)) for each in scenarios]
    batch = BatchedScenario.of(scenarios)
    world = World(batch, guard_entries=False)
    table = world.reset()
    for step in range(batch.total_steps + 1):
        for scene, own in enumerate(batch.tables(table)):
            np.testing.assert_array_equal(own.id, alone[scene][step].id)
            np.testing.assert_array_equal(own.x, alone[scene][step].x)
            np.testing.assert_array_equal(own.controller, alone[scene][step].controller)
        if step < batch.total_steps:
            table = world.step_batch(ControlTable.empty(step), [EgoCommand(step)] * 4)
