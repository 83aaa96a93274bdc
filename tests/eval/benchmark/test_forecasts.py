"""The traffic that predictors are timed on, and that they are timed on all of it."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

from litsim_eval.benchmark.forecasts import (
    AGENTS_MOST,
    SCENARIO,
    WARM_UP,
    Timing,
    columns_of_traffic,
    time_models,
    time_predictors,
)
from litsim_predictor.kinematic import KinematicPredictor
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import STEP_S
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario


def test_the_traffic_is_on_the_road_and_nobody_overlaps() -> None:
    lane_map = Scenario.load(SCENARIO).lane_map
    steps = WARM_UP + 100
    log = Log.from_recording(columns_of_traffic(AGENTS_MOST, steps * STEP_S, first_id=7), 0, steps + 1)
    for step in (0, steps):
        table = log.table(step)
        assert (len(table), table.row(7)) == (AGENTS_MOST, 0)
        assert lane_map.inside_road(table.x, table.y).all()
        assert not len(overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width))


def test_every_model_is_timed_with_every_number_of_agents() -> None:
    found = list(time_models(["kinematic"], [10, 40], steps=3))
    assert [(model, agents) for model, agents, _ in found] == [("kinematic", 10), ("kinematic", 40)]
    for _, _, timing in found:
        assert 0.0 < timing.least <= timing.median <= timing.most
    assert str(Timing(2.0, 1.0, 3.456)) == "2.00 (1.00 to 3.46)"


@pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")
def test_learned_models_are_timed_as_torch_runs_them_too() -> None:
    found = list(time_models(["kinematic", "default"], [10], steps=2, by_torch=True))
    assert [model for model, _, _ in found] == ["kinematic", "default", "default (torch)"]


def test_a_predictor_that_leaves_agents_out_is_not_timed() -> None:
    with pytest.raises(InputError, match="of 40 agents were forecast"):
        list(time_predictors({"kinematic": KinematicPredictor(7, roi_m=20.0)}, 7, 40, steps=1))


@pytest.mark.parametrize(("models", "agents"), [(["kinematic"], [0]), (["kinematic"], [251]), (["none"], [10])])
def test_what_cannot_be_timed_is_refused(models: list[str], agents: list[int]) -> None:
    with pytest.raises(InputError, match="expected"):
        list(time_models(models, agents, steps=1))
