"""Predictors by name."""

from __future__ import annotations

from litsim_predictor.forecast import Predictor
from litsim_predictor.kinematic import KinematicConfig, KinematicPredictor
from litsim_sim.errors import InputError
from litsim_sim.scenario import Scenario

MODELS = ("kinematic",)


def make_predictor(model: str, scenario: Scenario, kinematic: KinematicConfig | None = None) -> Predictor:
    """The predictor called `model` (one of :data:`MODELS`), for a run of `scenario`.

    Raises:
        InputError: there is none of that name.
    """
    if model not in MODELS:
        raise InputError(f"predictor: parameter model is {model!r}, expected one of {', '.join(MODELS)}")
    return KinematicPredictor(scenario.ego_id, scenario.roi_m, kinematic)
