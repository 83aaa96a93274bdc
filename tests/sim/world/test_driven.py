"""What the answers to a step do to the vehicles that they list."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.scene import STEP_S, Controller, ControlSource, ControlTable, EgoCommand
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.driven import BACKGROUND, DrivenVehicles, check_answers

EGO, OTHER, THIRD = 1, 2, 3
EGOS = np.array([EGO])


@pytest.fixture(scope="module")
def scenario(make_scenario: Callable[..., Any], track: type) -> Scenario:
    tracks = (track(id=EGO, x=50.0), track(id=OTHER, x=100.0), track(id=THIRD, x=600.0, last=30))
    return make_scenario(*tracks)  # type: ignore[no-any-return]


def controls(step: int, agents: list[int], acceleration: float, source: ControlSource) -> ControlTable:
    n = len(agents)
    zero = np.zeros(n)
    sources = np.full(n, source, np.uint8)
    return ControlTable(step, np.array(agents, np.int64), np.full(n, acceleration), zero, zero, sources)


def test_only_who_is_listed_moves(scenario: Scenario) -> None:
    vehicles = DrivenVehicles(scenario)
    before = scenario.log.table(5)
    after = vehicles.step(before, controls(5, [OTHER], -2.0, ControlSource.POLICY), [None])
    assert (after.step, after.id.tolist(), after.controller.tolist()) == (6, [OTHER], [Controller.POLICY])
    assert after.speed[0] == pytest.approx(before.speed[before.row(OTHER)] - 2.0 * STEP_S)


def test_the_ego_drives_with_its_own_command(scenario: Scenario) -> None:
    vehicles = DrivenVehicles(scenario)
    listed = controls(5, [OTHER], 1.0, ControlSource.HANDBACK)
    after = vehicles.step(scenario.log.table(5), listed, [EgoCommand(5, -1.0, 0.0)])
    assert after.id.tolist() == [EGO, OTHER]
    assert after.controller.tolist() == [Controller.EGO, Controller.POLICY]
    assert after.speed == pytest.approx([10.0 - STEP_S, 10.0 + STEP_S])


def test_who_follows_its_log_late_is_not_driven(scenario: Scenario) -> None:
    vehicles = DrivenVehicles(scenario)
    assert not len(vehicles.step(scenario.log.table(5), controls(5, [OTHER], 0.0, ControlSource.LATE), [None]))


def test_commands_stay_within_the_limits(scenario: Scenario) -> None:
    listed = controls(5, [OTHER], -50.0, ControlSource.POLICY)
    after = DrivenVehicles(scenario).step(scenario.log.table(5), listed, [None])
    assert after.acceleration[0] == pytest.approx(-BACKGROUND.deceleration_max)


def test_who_is_off_the_road_is_gone_once_its_log_is_over(scenario: Scenario) -> None:
    vehicles = DrivenVehicles(scenario)
    there = scenario.log.table(30)
    away = there.take(np.array([there.row(THIRD)]))
    away.x[0] = 900.0  # beyond the end of the net
    listed = controls(30, [THIRD], 0.0, ControlSource.POLICY)
    assert not len(vehicles.step(away, listed, [None]))
    away = scenario.log.table(29).take(np.array([scenario.log.table(29).row(THIRD)]))
    away.x[0] = 900.0
    assert vehicles.step(away, controls(29, [THIRD], 0.0, ControlSource.POLICY), [None]).id.tolist() == [THIRD]


@pytest.mark.parametrize(
    ("agents", "ego", "message"),
    [
        ([OTHER], EgoCommand(4, 0.0, 0.0), r"steps 5 \(controls\) and 4 \(ego\), expected 5"),
        ([OTHER], EgoCommand(5, float("nan"), 0.0), "ego control at step 5 is not finite"),
        ([THIRD, OTHER], EgoCommand(5, 0.0, 0.0), "do not ascend"),
        ([EGO, OTHER], EgoCommand(5, 0.0, 0.0), "list the ego, 1"),
    ],
)
def test_answers_that_cannot_be_applied(agents: list[int], ego: EgoCommand, message: str) -> None:
    check_answers(5, EGOS, controls(5, [OTHER], 0.0, ControlSource.POLICY), [EgoCommand(5, 0.0, 0.0)])
    with pytest.raises(ValueError, match=message):
        check_answers(5, EGOS, controls(5, agents, 0.0, ControlSource.POLICY), [ego])


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
@pytest.mark.parametrize("field", ["acceleration", "lateral_acceleration", "yaw_rate"])
def test_controls_that_are_not_finite(scenario: Scenario, field: str, bad: float) -> None:
    answer = controls(5, [OTHER], 0.0, ControlSource.POLICY)
    getattr(answer, field)[0] = bad
    with pytest.raises(ValueError, match="controls at step 5 are not finite"):
        check_answers(5, EGOS, answer, [EgoCommand(5)])
