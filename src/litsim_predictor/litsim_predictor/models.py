"""Predictors by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from importlib.util import find_spec
from typing import Annotated

from pydantic import AfterValidator

from litsim_predictor.forecast import Predictor
from litsim_predictor.kinematic import KinematicConfig, KinematicPredictor
from litsim_predictor.learned import SHIPPED
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import configuration
from litsim_sim.scenario.scenario import Scenario

MODELS = ("kinematic", *SHIPPED)


def known_model(name: str) -> str:
    """Check that `name` is one of :data:`MODELS`, or that of a file of weights; returns it.

    Raises:
        ValueError: it is neither.
    """
    if name not in MODELS and not name.endswith(".safetensors"):
        raise ValueError(f"expected one of {', '.join(MODELS)}, or a file *.safetensors")
    return name


ModelName = Annotated[str, AfterValidator(known_model)]
"""Type of a field that names a predictor."""


def default_model() -> str:
    """What forecasts unless told otherwise: the learned model where torch is installed."""
    return "default" if find_spec("torch") else "kinematic"


@configuration
class PredictorConfig:
    """Parameters of the predictor stage.

    Attributes:
        model: see :func:`make_predictor`.
        kinematic: of the model of that name.
    """

    model: ModelName = field(default_factory=default_model)
    kinematic: KinematicConfig = KinematicConfig()


def predictor_stage(read: ParameterReader) -> Callable[[Scenario], Predictor]:
    """Read the parameters; what is returned builds the predictor once the run is known."""
    config = read(PredictorConfig())
    return lambda scenario: make_predictor(config.model, scenario, config.kinematic)


def make_predictor(model: str, scenario: Scenario, kinematic: KinematicConfig | None = None) -> Predictor:
    """The predictor called `model`, for a run of `scenario`.

    Args:
        model: one of :data:`MODELS`, or the path of a file of weights.
        scenario: of the run.
        kinematic: parameters of that model.

    Raises:
        InputError: there is none of that name, or its weights cannot be used.
    """
    if model == "kinematic":
        return KinematicPredictor(scenario.ego_id, scenario.roi_m, kinematic)
    try:
        known_model(model)
    except ValueError as error:
        raise InputError(f"predictor: parameter model is {model!r}, {error}") from error
    # torch takes seconds to import, and is not needed for the kinematic model.
    if not find_spec("torch"):
        raise InputError(f"predictor: model {model} needs torch, which is not installed here; kinematic does not")
    import torch

    from litsim_predictor.learned.data.raster import raster_of_net
    from litsim_predictor.learned.models.weights import load_model
    from litsim_predictor.learned.predictor import LearnedPredictor

    # Scenes are small: on shared cores a second thread is mostly waited for; and rounding depends on their number.
    torch.set_num_threads(1)
    trained, _ = load_model(model)
    return LearnedPredictor(trained, scenario.ego_id, scenario.roi_m, *raster_of_net(scenario.net_path))
