"""Networks that were trained in the environments drive in runs and in campaigns as they did there."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

import litsim
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation
from networks import exported

BRAKING = -0.5, 0.0
"""Acceleration and yaw rate, as shares of 4 m/s2 and 0.15 rad/s."""


@pytest.fixture(scope="module")
def ego(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("ego") / "braking.onnx", 52, *BRAKING)


def test_the_ego_drives_as_in_its_environment(ego: Path) -> None:
    demo = Scenario.load("demo", simulation_s=5.0)
    environment = gymnasium.make("litsim_research.gym:litsim/Ego-v0", scenario=demo, policy="yield").unwrapped
    environment.reset(seed=0)
    own = environment._scenario
    simulation = Simulation([own, own], "onnx", "yield", {"ego": {"weights": str(ego)}})
    while simulation.table.step < own.history_steps:
        simulation.step()
    for _ in range(15):
        environment.step(np.array(BRAKING, np.float32))
        there, here = environment._simulation.table, simulation.step()
        for own_table in simulation.batch.tables(here):
            assert own_table.x.tolist() == there.x.tolist() and own_table.y.tolist() == there.y.tolist()


def test_a_campaign_runs_networks_of_ego_and_agents(ego: Path, tmp_path: Path) -> None:
    agents = exported(tmp_path / "agents.onnx", 81, -0.2, 0.0, 0.0)
    suite = {
        "name": "mine",
        "cases": [{"scenario": "demo", "ego_id": "ego"}],
        "egos": ["onnx"],
        "policies": ["litsim"],
        "parameters": {"ego.weights": [str(ego)], "policy.weights": [str(agents)]},
    }
    (results,) = litsim.evaluate(suite, tmp_path / "campaign", processes=1).variants.values()
    assert results[0].metrics["takeovers"] > 0


def test_an_ego_without_a_network_is_refused() -> None:
    with pytest.raises(InputError, match="weights is empty"):
        Simulation(Scenario.load("demo"), "onnx", "replay")
