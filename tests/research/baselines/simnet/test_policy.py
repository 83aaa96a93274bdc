"""The baseline `simnet`: of what the network says, the first step is done; and which network that is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_policy.driving.registry import policy_stage
from litsim_research.baselines.simnet.output import OUTPUTS
from litsim_research.baselines.simnet.plugin import Simnet, SimnetConfig
from litsim_research.baselines.simnet.raster import CHANNELS, FRAMES, OTHERS, OWN, SMALL
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.scene import Controller, ControlSource
from litsim_sim.core.stages import POLICY
from litsim_sim.core.takeover import TakeoverTable
from made_agents import takeovers_in_region

SPEED, GAP = 10.0, 15.0


class Says:
    """A network that says the same of everybody, and keeps what it was shown."""

    source = Path("says.safetensors")

    def __init__(self, ahead: float, turn: float) -> None:
        self._said = np.zeros(OUTPUTS, np.float32)
        self._said[[0, 2, 3, 5]] = ahead, turn, 99.0, 9.0  # of the second step nothing is to be seen
        self.shown = np.empty(0)

    def __call__(self, rasters: np.ndarray) -> np.ndarray:
        self.shown = rasters.copy()
        return np.tile(self._said, (len(rasters), 1))


@pytest.fixture
def scenario(make_scenario: Any, track: Any) -> Any:
    """Three in a column, 1 ahead."""
    return make_scenario(*(track(k, x=230.0 - GAP * k, speed=SPEED) for k in (1, 2, 3)), roi_m=30.0)


def test_the_first_step_is_done_as_acceleration_and_yaw_rate(scenario: Any) -> None:
    network = Says(ahead=1.03, turn=0.002)
    policy = Simnet(scenario, SimnetConfig(), network)
    for step in range(7):
        listed = takeovers_in_region(step, 2, 3) if step == 6 else TakeoverTable(step)
        controls = policy.act(scenario.log.table(step), listed)
        assert len(controls.id) == len(listed.takeovers)
    assert controls.id.tolist() == [2, 3] and controls.source.tolist() == [ControlSource.POLICY] * 2
    assert controls.acceleration == pytest.approx(3.0, abs=1e-4)  # 1.03 m in a step are 10.3 m/s, 0.3 more than now
    assert controls.yaw_rate == pytest.approx(0.02, abs=1e-6)
    assert controls.lateral_acceleration == pytest.approx(SPEED * 0.02, abs=1e-5)


def test_everybody_is_shown_half_a_second_of_everybody(scenario: Any) -> None:
    network = Says(1.0, 0.0)
    policy = Simnet(scenario, SimnetConfig(), network)
    for step in range(8):
        policy.act(scenario.log.table(step), takeovers_in_region(step, 2, 3))
    assert network.shown.shape == (2, CHANNELS, SMALL.rows, SMALL.columns)
    rows = np.arange(SMALL.rows) + 0.5 - 0.25 * SMALL.rows
    for frame in range(FRAMES):
        own = network.shown[0, OWN + frame].sum(axis=1)
        assert np.average(rows, weights=own) == pytest.approx(-SPEED * 0.1 * (FRAMES - 1 - frame), abs=0.02)
    behind_two, behind_three = network.shown[:, OTHERS + FRAMES - 1].sum(axis=2)
    assert np.average(rows, weights=behind_two) == pytest.approx(0.0, abs=0.02)  # one ahead, one behind
    assert np.average(rows, weights=behind_three) == pytest.approx(1.5 * GAP, abs=0.02)


def test_at_the_first_step_there_is_no_history(scenario: Any) -> None:
    network = Says(1.0, 0.0)
    Simnet(scenario, SimnetConfig(), network).act(scenario.log.table(0), takeovers_in_region(0, 2))
    assert network.shown[0, OWN + FRAMES - 1].any() and not network.shown[0, OWN : OWN + FRAMES - 1].any()


def test_what_is_no_finite_number_ends_the_run_by_the_name_of_the_file(scenario: Any) -> None:
    policy = Simnet(scenario, SimnetConfig(), Says(1.0, float("nan")))
    with pytest.raises(InputError, match=r"says\.safetensors: not all poses predicted at step 0 are finite"):
        policy.act(scenario.log.table(0), takeovers_in_region(0, 2))


def test_an_empty_answer_to_no_takeovers(scenario: Any) -> None:
    assert len(Simnet(scenario, SimnetConfig(), Says(1.0, 0.0)).act(scenario.log.table(5), TakeoverTable(5)).id) == 0


def test_it_drives_on_an_empty_road(make_scenario: Any, track: Any, drive: Any) -> None:
    """With the weights that come with LitSim: on its lane for five seconds, neither stopping nor racing."""
    scenario = make_scenario(
        track(1, x=150.0, speed=12.0, last=70), track(2, x=130.0, speed=12.0, last=70), history_steps=10, roi_m=30.0
    )
    run = drive(scenario, "log", policy="simnet")
    driven = run.series(2, "controller") == Controller.POLICY
    assert driven.sum() > 50
    assert np.abs(run.series(2, "y") + 5.49)[driven].max() < 1.8
    assert np.abs(run.series(2, "speed") - 12.0)[driven].max() < 8.0
    assert np.abs(run.series(2, "speed") - 12.0)[driven].max() > 1e-3  # it is no replay


def test_weights_that_do_not_fit(scenario: Any) -> None:
    with pytest.raises(InputError, match=r"a\.safetensors: no such weights of simnet"):
        policy_stage(ParameterOverrides(POLICY, {"simnet.weights": "a.safetensors"}))("simnet", scenario)
