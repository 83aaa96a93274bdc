"""Drivers that differ: drawn by the seed of the scene and the agent's id, and by nothing else."""

import numpy as np
import pytest

from litsim_policy.driving.drawn_drivers import DrawnDrivers, SpreadConfig, correlated
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.scenario import Scenario

CONFIG = SpreadConfig()
EVERYBODY = np.arange(1, 41)


@pytest.fixture(scope="module")
def scenario(make_scenario, track) -> Scenario:
    """Forty vehicles, four abreast."""
    lanes = (-1.83, -5.49, -9.15, -12.81)
    return make_scenario(*(track(k, x=60.0 + 12.0 * (k // 4), y=lanes[k % 4]) for k in EVERYBODY.tolist()))


def drivers(scenario: Scenario, step: int = 5) -> tuple[np.ndarray, np.ndarray]:
    return DrawnDrivers(scenario, CONFIG).of(EVERYBODY, step)


def test_they_differ_by_as_much_as_told(scenario: Scenario) -> None:
    factor, noise = drivers(scenario)
    assert np.log(factor).std() == pytest.approx(CONFIG.headway, rel=0.25)
    assert noise.std() == pytest.approx(CONFIG.noise, rel=0.25)


def test_the_seed_and_the_id_decide(scenario: Scenario) -> None:
    assert all((a == b).all() for a, b in zip(drivers(scenario), drivers(scenario), strict=True))
    assert all((a != b).all() for a, b in zip(drivers(scenario), drivers(scenario.around(None, 1)), strict=True))


def test_in_a_batch_they_are_who_they_are_alone(scenario: Scenario) -> None:
    other = scenario.around(None, 1)
    together = DrawnDrivers(BatchedScenario.of([scenario, other]), CONFIG).of(np.arange(80), 5)
    for both, first, second in zip(together, drivers(scenario), drivers(other), strict=True):
        assert (both == np.concatenate([first, second])).all()


def test_noise_is_correlated_as_long_as_told() -> None:
    noise = correlated(np.random.default_rng(0).standard_normal(20_000), 0.1)
    assert noise.std() == pytest.approx(1.0, abs=0.1)
    assert np.corrcoef(noise[10:], noise[:-10])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.05)


def test_drawn_drivers_drive_otherwise_by_seed_and_touch_nobody(make_scenario, track, drive) -> None:
    """Agent 2 follows the ego, which brakes."""
    scenario = make_scenario(track(1, x=200.0, last=110), track(2, x=175.0, last=110), history_steps=30)
    ends = set()
    for seed in range(3):
        run = drive(
            scenario.around(None, seed),
            lambda table, _: (-2.0 if table.step < 50 else 0.0, 0.0),
            policy="litsim",
            parameters={"policy": {"drivers": "drawn"}},
        )
        assert run.world.contacts == {} and run.takeovers(2)
        ends.add(float(run.series(2, "x")[-1]))
    assert len(ends) == 3
