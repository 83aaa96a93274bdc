"""Predictors by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

from litsim_predictor.forecast import NoPredictor, Predictor
from litsim_predictor.inference import SHIPPED
from litsim_predictor.inference.contract import NO_MODES, ModeChoice, Network
from litsim_predictor.kinematic import KinematicConfig, KinematicPredictor
from litsim_predictor.selection import Wanted
from litsim_research.oracle import OraclePredictor
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import Flag, Length, NonNegative, configuration
from litsim_sim.scenario.happened import Happened
from litsim_sim.scenario.run_info import BASELINES
from litsim_sim.scenario.setting import Setting

MODELS = ("kinematic", *SHIPPED)
DEFAULT_MODEL = "default"
"""What forecasts unless told otherwise."""
FILES = (".safetensors", ".onnx")
"""Endings of files of weights, and of graphs."""


def known_model(name: str) -> str:
    """Check that `name` is one of :data:`MODELS`, or that of a file of weights or of a graph; returns it.

    Raises:
        ValueError: it is neither.
    """
    if name not in MODELS and not name.endswith(FILES):
        raise ValueError(f"expected one of {', '.join(MODELS)}, or a file *{' or *'.join(FILES)}")
    return name


ModelName = Annotated[str, AfterValidator(known_model)]
"""Type of a field that names a predictor."""


@configuration
class PredictorConfig:
    """Parameters of the predictor stage.

    Attributes:
        model: see :func:`make_predictor`.
        roi_m: radius around agents off their log within which agents are looked at; 0 is the scenario's.
        happened: folder of what happened in earlier runs, which is forecast instead of what a model expects
            (:class:`litsim_sim.scenario.happened.Happened`): an oracle, for experiments; empty is none.
        forecast_all: whether all agents of interest are forecast, and not only those whose forecast is read.
        modes: which manoeuvres of an agent are forecast beside the most probable one, by models run by kernels.
        along_lanes: whether learned models forecast along lanes that bend; see
            :mod:`litsim_predictor.inference.ways`.
        kinematic: of the model of that name.
    """

    model: ModelName = DEFAULT_MODEL
    roi_m: NonNegative[Length] = 0.0
    happened: str = ""
    forecast_all: bool = False
    modes: ModeChoice = ModeChoice()
    along_lanes: Flag = True
    kinematic: KinematicConfig = KinematicConfig()


def predictor_stage(read: ParameterReader) -> Callable[[str, Setting], Predictor]:
    """Read the parameters; the result builds the predictor for a policy once the run is known."""
    config = read(PredictorConfig())
    wanted = Wanted.ALL if config.forecast_all else Wanted.READ

    def build(policy: str, scenario: Setting) -> Predictor:
        if policy in BASELINES and not config.forecast_all:
            return NoPredictor()
        if config.happened:
            known = Happened.read(Path(config.happened), scenario)
            roi_m = config.roi_m or scenario.roi_m
            return OraclePredictor(known, scenario.log.ids, scenario.ego_ids, roi_m, wanted)
        return make_predictor(
            config.model, scenario, config.kinematic, wanted, config.roi_m, config.modes, along_lanes=config.along_lanes
        )

    return build


def make_predictor(
    model: str,
    scenario: Setting,
    kinematic: KinematicConfig | None = None,
    wanted: Wanted = Wanted.READ,
    roi_m: float = 0.0,
    modes: ModeChoice | None = None,
    *,
    along_lanes: bool = True,
) -> Predictor:
    """The predictor called `model`, for a run of `scenario`.

    Args:
        model: one of :data:`MODELS`, or the path of a file of weights or of a graph.
        scenario: of the run.
        kinematic: parameters of that model.
        wanted: the agents that it forecasts.
        roi_m: in place of the scenario's, where it is not 0 [m].
        modes: which of their manoeuvres matter; by default only the most probable one.
        along_lanes: whether a learned model forecasts along lanes that bend.

    Raises:
        InputError: there is none of that name, or its weights cannot be used.
    """
    roi_m = roi_m or scenario.roi_m
    if model == "kinematic":
        return KinematicPredictor(scenario.ego_ids, roi_m, kinematic, wanted)
    try:
        known_model(model)
    except ValueError as error:
        raise InputError(f"predictor: parameter model is {model!r}, {error}") from error
    from litsim_predictor.inference.predictor import LearnedPredictor
    from litsim_predictor.inference.raster import raster_of_net

    net = raster_of_net(scenario.net_path)
    choice = modes or NO_MODES
    return LearnedPredictor(network(model), scenario.ego_ids, roi_m, *net, wanted, choice, along_lanes=along_lanes)


def network(model: str) -> Network:
    """The trained model `model`, compiled; by torch where it has neither kernels nor a graph.

    Runs of one process share it: it remembers nothing of a scene.

    Raises:
        InputError: its file cannot be used, or torch is needed and is not installed.
    """
    file = Path(model)
    return _network(model, file.stat().st_mtime_ns if file.is_file() else 0)


@lru_cache(maxsize=4)
def _network(model: str, modified: int) -> Network:
    """See :func:`network`; `modified` is when its file was [ns], so that another file is another model."""
    del modified
    from litsim_predictor.inference.networks import compiled

    found = compiled(model)
    if found is not None:
        return found
    if not find_spec("torch"):
        raise InputError(
            f"{model}: weights of a model that comes without a graph need torch, which is not installed here; "
            "litsim_research export makes a graph of them where it is"
        )
    from litsim_research.predictors.eager import EagerNetwork
    from litsim_research.predictors.models.weights import load_model

    return EagerNetwork(load_model(model)[0], model)
