"""The traffic that predictors are timed on, and that they are timed on all of it."""

from __future__ import annotations

import pytest

from litsim_predictor.kinematic import KinematicPredictor
from litsim_predictor.learned.benchmark import (
    AGENTS_MOST,
    SCENARIO,
    WARM_UP,
    Timing,
    columns_of_traffic,
    models_here,
    time_models,
    time_predictor,
)
from litsim_predictor.learned.weights import SHIPPED, path_of
from litsim_sim.errors import InputError
from litsim_sim.geometry import overlapping_pairs
from litsim_sim.scenario import Scenario


def test_the_traffic_is_on_the_road_and_nobody_overlaps() -> None:
    lane_map = Scenario.load(SCENARIO).lane_map
    for step in (0, WARM_UP + 100):
        table = columns_of_traffic(step, 7, AGENTS_MOST)
        assert (len(table), table.row(7)) == (AGENTS_MOST, 0)
        assert lane_map.inside_road(table.x, table.y).all()
        assert not len(overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width))


def test_every_model_is_timed_with_every_number_of_agents() -> None:
    found = list(time_models(["kinematic"], [10, 40], steps=3))
    assert [(model, agents) for model, agents, _ in found] == [("kinematic", 10), ("kinematic", 40)]
    for _, _, timing in found:
        assert 0.0 < timing.least <= timing.median <= timing.most
    assert str(Timing(2.0, 1.0, 3.456)) == "2.00 (1.00 to 3.46)"


def test_predictors_without_weights_are_left_out() -> None:
    assert models_here()[0] == "kinematic"
    assert set(models_here()[1:]) == {name for name in SHIPPED if path_of(name).is_file()}


def test_a_predictor_that_leaves_agents_out_is_not_timed() -> None:
    with pytest.raises(InputError, match="of 40 agents were forecast"):
        time_predictor(KinematicPredictor(7, roi_m=20.0), 7, 40, steps=1)


@pytest.mark.parametrize(("models", "agents"), [(["kinematic"], [0]), (["kinematic"], [251]), (["none"], [10])])
def test_what_cannot_be_timed_is_refused(models: list[str], agents: list[int]) -> None:
    with pytest.raises(InputError, match="expected"):
        list(time_models(models, agents, steps=1))
