"""The baseline `rollout`: agents drive where the predictor expects them, as fast, and onwards without a forecast."""

from typing import Any

import numpy as np
import pytest

from litsim_predictor.forecast import Wanted
from litsim_predictor.models import make_predictor
from litsim_research.baselines.rollout import Rollout, RolloutConfig, along
from litsim_sim.core.scene import ControlSource
from litsim_sim.scenario.scenario import Scenario
from made_agents import takeovers_in_region

SPEED = 10.0
TIMES = np.array([0.2, 0.4, 0.6, 0.8, 1.0])


@pytest.fixture
def scenario(make_scenario: Any, track: Any) -> Scenario:
    return make_scenario(track(1, x=200.0, speed=SPEED), track(2, x=170.0, speed=SPEED), roi_m=40.0)


@pytest.mark.parametrize("acceleration", [-2.0, 0.0, 1.5])
def test_a_future_is_driven_as_it_says(scenario: Scenario, acceleration: float) -> None:
    table = scenario.log.table(5)
    way = SPEED * TIMES + 0.5 * acceleration * TIMES**2
    curvature = 0.01
    x = table.x[1] + np.sin(curvature * way) / curvature
    y = table.y[1] + (1.0 - np.cos(curvature * way)) / curvature
    wanted, turn = along(table, np.array([1]), np.column_stack([x, y])[None], 0.2)
    assert wanted[0] == pytest.approx(acceleration, abs=0.02)
    assert turn[0] == pytest.approx(SPEED * curvature, rel=0.01)


def test_who_is_expected_to_stand_stops_and_does_not_reverse(scenario: Scenario) -> None:
    table = scenario.log.table(5)
    behind = np.column_stack([table.x[1] - TIMES, np.full(5, table.y[1])])[None]
    braking, turn = along(table, np.array([1]), behind, 0.2)
    assert braking[0] < -8.0 and turn[0] == 0.0, "harder than any vehicle, which its limits cut"
    slow = scenario.log.table(5)
    slow.speed[1] = 0.1
    assert along(slow, np.array([1]), behind, 0.2)[0] == pytest.approx(-1.0)


def test_the_network_that_forecasts_drives(scenario: Scenario) -> None:
    policy = Rollout(scenario, RolloutConfig())
    predictor = make_predictor("default", scenario, Wanted.ALL)
    for step in range(30):
        policy.act(scenario.log.table(step), takeovers_in_region(step))
        predictor.observe(scenario.log.table(step))
    table = scenario.log.table(30)
    controls, forecast = policy.act(table, takeovers_in_region(30, 2)), predictor.forecast(table)
    expected = along(table, table.rows(np.array([2])), forecast.mean[forecast.rows(np.array([2])), :5], 0.2)
    assert controls.source.tolist() == [ControlSource.POLICY]
    assert (controls.acceleration[0], controls.yaw_rate[0]) == (expected[0][0], expected[1][0])
    assert abs(controls.acceleration[0]) < 1.0, "nothing is in its way"


def test_without_a_forecast_speed_and_heading_are_kept(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = Rollout(scenario, RolloutConfig())
    forecast = policy._predictor.forecast(scenario.log.table(0))
    forecast.valid[:] = False
    monkeypatch.setattr(policy._predictor, "forecast", lambda _: forecast)
    controls = policy.act(scenario.log.table(5), takeovers_in_region(5, 2))
    assert (controls.acceleration.tolist(), controls.yaw_rate.tolist()) == ([0.0], [0.0])
