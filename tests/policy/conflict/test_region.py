"""Who baselines drive: everybody who comes near the ego, from then on, along his lane."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_policy.conflict.region import RegionManager
from litsim_policy.conflict.registry import conflict_stage
from litsim_policy.conflict.takeover import TakeoverManager
from litsim_predictor.forecast import Forecast
from litsim_predictor.models import make_predictor
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.scene import Controller, Kind
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverState, TakeoverTable
from litsim_sim.scenario.scenario import Scenario

FIRST = 3  # first step after the history


@pytest.fixture
def scenario(make_scenario: Callable[..., Scenario], track: Any) -> Scenario:
    """The ego at 200 m; behind it one who is within 30 m, and one who is not."""
    return make_scenario(track(1, x=200.0), track(2, x=172.0), track(3, x=100.0), history_steps=FIRST, roi_m=30.0)


def see(manager: RegionManager, scenario: Scenario, step: int, placed: Any, **ego: float) -> TakeoverTable:
    table = scenario.log.table(step)
    table = placed(table, scenario.ego_id, **ego) if ego else table
    return manager.update(table, Forecast.empty(step))


def agents(answer: TakeoverTable) -> list[int]:
    return [takeover.agent for takeover in answer.takeovers]


def test_those_near_the_ego_are_driven_after_the_history(scenario: Scenario, placed: Any) -> None:
    manager = RegionManager(scenario)
    assert agents(see(manager, scenario, FIRST - 1, placed)) == []
    answer = see(manager, scenario, FIRST, placed)
    (taken,) = answer.takeovers
    assert (taken.agent, taken.reason, taken.state) == (2, TakeoverReason.REGION, TakeoverState.HELD)
    assert (taken.detected_step, taken.opponent, taken.log_collision_predicted) == (FIRST, 1, False)
    assert taken.path_source == PathSource.LANE and taken.residual_position == pytest.approx(0.0)
    assert answer.iterations == 0 and answer.converged


def test_pedestrians_and_cyclists_are_not(make_scenario: Callable[..., Scenario], track: Any, placed: Any) -> None:
    walkers = [track(n, x=200.0 + n, y=-8.0, kind=kind) for n, kind in ((4, Kind.PEDESTRIAN), (5, Kind.BICYCLE))]
    made = make_scenario(track(1, x=200.0), track(2, x=172.0), *walkers, history_steps=FIRST, roi_m=30.0)
    assert agents(see(RegionManager(made), made, FIRST, placed)) == [2]


def test_nobody_is_given_back(scenario: Scenario, placed: Any) -> None:
    manager = RegionManager(scenario)
    see(manager, scenario, FIRST, placed)
    assert agents(see(manager, scenario, FIRST + 1, placed, x=120.0)) == [2, 3], "2 stays, 3 comes"
    last = see(manager, scenario, FIRST + 2, placed, x=500.0)
    assert agents(last) == [2, 3] and [t.state for t in last.takeovers] == [TakeoverState.HELD] * 2


def test_who_enters_late_is_driven_wherever_he_is(scenario: Scenario) -> None:
    table = scenario.log.table(FIRST)
    table.controller[table.row(3)] = Controller.POLICY
    answer = RegionManager(scenario).update(table, Forecast.empty(FIRST))
    assert {t.agent: t.reason for t in answer.takeovers} == {
        2: TakeoverReason.REGION,
        3: TakeoverReason.BLOCKED_ENTRY,
    }


def test_they_keep_the_lane_that_they_were_on(make_scenario: Any, track: Any, placed: Any) -> None:
    changes = track(2, x=180.0, y=-9.15)  # its log is not where it is put below: in the lane to the left
    scenario = make_scenario(track(1, x=200.0, y=-9.15), changes, history_steps=FIRST, roi_m=30.0)
    table = placed(scenario.log.table(FIRST), 2, y=-5.49)
    (taken,) = RegionManager(scenario).update(table, Forecast.empty(FIRST)).takeovers
    np.testing.assert_allclose(taken.reference_path[:, 1], -5.49, atol=0.1)
    assert taken.residual_position == pytest.approx(3.66, abs=0.01)


def test_the_policy_says_who_is_taken_over(scenario: Scenario) -> None:
    build = conflict_stage(ParameterOverrides("conflict", {}))
    assert all(isinstance(build(name, scenario), RegionManager) for name in ("idm", "simnet"))
    assert isinstance(build("yield", scenario), TakeoverManager)


def test_a_region_of_its_own_is_in_place_of_the_scenario_s(scenario: Scenario, placed: Any) -> None:
    build = conflict_stage(ParameterOverrides("conflict", {"roi_m": 25.0}))
    assert agents(see(build("idm", scenario), scenario, FIRST, placed)) == []


def test_everybody_is_driven_from_the_first_step_on(scenario: Scenario, placed: Any) -> None:
    manager = conflict_stage(ParameterOverrides("conflict", {"baselines": "all"}))("idm", scenario)
    assert agents(see(manager, scenario, FIRST - 1, placed)) == []
    assert agents(see(manager, scenario, FIRST, placed)) == [2, 3]


def test_whom_others_would_take_over_is_told_by_forecasts(scenario: Scenario, placed: Any) -> None:
    """As for policies that know conflicts; without a forecast of the ego, nobody could be told."""
    build = conflict_stage(ParameterOverrides("conflict", {"baselines": "conflict"}))
    manager = build("idm", scenario)
    assert isinstance(manager, TakeoverManager)
    assert agents(see(manager, scenario, FIRST - 1, placed)) == []
    with pytest.raises(InputError, match="parameter baselines is conflict, which needs forecasts of the ego"):
        see(manager, scenario, FIRST, placed)
    table = placed(scenario.log.table(FIRST), 1, x=178.0, speed=0.0)
    (taken,) = (
        build("idm", scenario)
        .update(table, make_predictor("kinematic", scenario, roi_m=30.0).forecast(table))
        .takeovers
    )
    assert (taken.agent, taken.reason) == (2, TakeoverReason.CONFLICT)
