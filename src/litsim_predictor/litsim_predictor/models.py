"""Predictors by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec

from litsim_predictor.forecast import Predictor
from litsim_predictor.kinematic import KinematicConfig, KinematicPredictor
from litsim_predictor.learned import SHIPPED
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.scenario.scenario import Scenario

MODELS = ("kinematic", *SHIPPED)


def default_model() -> str:
    """What forecasts unless told otherwise: the learned model where torch is installed."""
    return "default" if find_spec("torch") else "kinematic"


@dataclass(frozen=True)
class PredictorConfig:
    """Parameters of the predictor stage.

    Attributes:
        model: see :func:`make_predictor`.
        kinematic: of the model of that name.
    """

    model: str = field(default_factory=default_model)
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
    if model not in SHIPPED and not model.endswith(".safetensors"):
        raise InputError(
            f"predictor: parameter model is {model!r}, expected one of {', '.join(MODELS)}, or a file *.safetensors"
        )
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
