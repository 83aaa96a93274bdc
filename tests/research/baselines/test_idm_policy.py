"""The baseline `idm`: the model with the drivers that were asked for, behind whoever is on the lane, and no more."""

from typing import Any

import numpy as np
import pytest

from litsim_data.traffic.drivers import calibrated
from litsim_research.baselines.idm_policy import IdmPolicy, IdmPolicyConfig
from litsim_sim.core.scene import ControlSource
from litsim_sim.core.takeover import TakeoverState, TakeoverTable
from litsim_sim.scenario.policies import class_of_policy
from litsim_sim.scenario.scenario import Scenario
from made_agents import takeovers_in_region

SPEED, GAP, LENGTH = 10.0, 15.0, 4.5


@pytest.fixture
def scenario(make_scenario: Any, track: Any) -> Scenario:
    """Two who follow each other, the ego ahead."""
    return make_scenario(track(1, x=200.0), track(2, x=200.0 - GAP - LENGTH), roi_m=30.0)


def acceleration(scenario: Scenario, **config: Any) -> float:
    controls = IdmPolicy(scenario, IdmPolicyConfig(**config)).act(scenario.log.table(5), takeovers_in_region(5, 2))
    assert controls.id.tolist() == [2] and controls.source.tolist() == [ControlSource.POLICY]
    assert controls.yaw_rate[0] == pytest.approx(0.0, abs=1e-6)
    return float(controls.acceleration[0])


def by_hand(v0: float, headway: float, s0: float, a: float, b: float) -> float:
    """Behind somebody as fast as oneself."""
    assert b > 0.0
    return a * (1.0 - (SPEED / v0) ** 4 - ((s0 + SPEED * headway) / GAP) ** 2)


def test_the_published_drivers(scenario: Scenario) -> None:
    assert acceleration(scenario, drivers="published") == pytest.approx(by_hand(20.0, 0.5, 2.0, 3.0, 2.5))


def test_the_medians_of_all_who_were_calibrated(scenario: Scenario) -> None:
    medians = np.median(np.concatenate(list(calibrated().drivers.values())), axis=0)
    assert acceleration(scenario) == pytest.approx(by_hand(*medians))


def test_drawn_drivers_differ_from_each_other_and_not_from_run_to_run(make_scenario: Any, track: Any) -> None:
    behind = [track(k, x=200.0 - 20.0 * (k - 1)) for k in range(2, 6)]
    every = np.concatenate([rows for _, rows in sorted(calibrated().drivers.items())])
    accelerations = []
    for seed in (0, 0, 1):
        scenario = make_scenario(track(1, x=200.0), *behind, seed=seed)
        policy = IdmPolicy(scenario, IdmPolicyConfig(drivers="drawn"))
        policy.act(scenario.log.table(5), takeovers_in_region(5, 3))  # who was driven before does not matter
        accelerations.append(
            policy.act(scenario.log.table(5), takeovers_in_region(5, 2, 3, 4, 5)).acceleration.tolist()
        )
    assert accelerations[0] == accelerations[1] != accelerations[2]
    assert len(set(accelerations[0])) == 4
    possible = [every[:, 3] * (1 - (SPEED / every[:, 0]) ** 4 - ((every[:, 2] + SPEED * every[:, 1]) / 15.5) ** 2)]
    possible = np.maximum(possible[0], -8.0)
    assert all(np.isclose(possible, each).any() for each in accelerations[0])


def test_it_brakes_no_harder_than_it_may(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(track(1, x=200.0), track(2, x=200.0 - LENGTH - 0.5))
    assert acceleration(scenario) == -8.0
    assert acceleration(scenario, braking_max=5.0) == -5.0


def test_nobody_to_drive(scenario: Scenario) -> None:
    assert len(IdmPolicy(scenario, IdmPolicyConfig()).act(scenario.log.table(5), TakeoverTable(5)).id) == 0


def test_it_follows_an_ego_that_stops_and_is_never_given_back(scenario: Scenario, drive: Any) -> None:
    assert class_of_policy("idm") is IdmPolicy
    driven = drive(scenario, lambda table, row: (-3.0 if table.speed[row] > 0.3 else 0.0, 0.0), policy="idm")
    assert driven.life(2) == [TakeoverState.HELD]
    gap = driven.series(1, "x") - driven.series(2, "x") - LENGTH
    assert gap.min() > 0.5, "it does not touch the ego, whom its log drives into"
    assert driven.series(2, "speed")[-1] < 2.0
    assert scenario.log.table(60).x[1] > driven.series(1, "x")[-1]
