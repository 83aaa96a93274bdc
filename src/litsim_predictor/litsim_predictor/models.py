"""Predictors by name, and the predictor stage."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import AfterValidator

from litsim_predictor.forecast import NoPredictor, Predictor, PredictorPlugin, Scope, Wanted
from litsim_predictor.inference import ON_STREETS
from litsim_predictor.inference.contract import Network
from litsim_predictor.inference.predictor import LearnedPredictor
from litsim_predictor.inference.raster import raster_of_net
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.quantities import Flag, Length, NonNegative, Whole, configuration
from litsim_sim.core.stages import PREDICTOR
from litsim_sim.lane_map.lane_graph import of_streets
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.policies import drives_by_region
from litsim_sim.scenario.setting import Setting

DEFAULT_MODEL = "default"
"""What forecasts unless told otherwise."""
FILES = (".safetensors", ".onnx")
"""Endings of files of weights, and of graphs."""


class Learned(LearnedPredictor, PredictorPlugin):
    """A predictor whose network is packaged or in a file.

    Attributes:
        model: its name, or its file of weights or of a graph.
    """

    batched = True
    model: ClassVar[str]

    def __init__(self, scenario: Setting, scope: Scope) -> None:
        lane_map, raster = raster_of_net(scenario.net_path)
        ready = network(weights_on(self.model, lane_map))
        super().__init__(ready, scenario.ego_ids, scope, lane_map, raster, scenario.signals)


class Default(Learned):
    """The predictor called `default`: the joint network that forecasts best, with weights of its own on streets."""

    model = DEFAULT_MODEL


class Paper(Learned):
    """The predictor called `paper`, of the paper's section III-A."""

    model = "paper"


class CsLstm(Learned):
    """The predictor called `cs_lstm`: convolutional social pooling (Deo and Trivedi 2018)."""

    model = "cs_lstm"


class Bat(Learned):
    """The predictor called `bat` (Liao et al. 2024), which also drives the ego of that name."""

    model = "bat"


def model_names() -> tuple[str, ...]:
    """Returns the names of the installed predictors."""
    return plugins.names(plugins.PREDICTORS)


def known_model(name: str) -> str:
    """Check that `name` is one of :func:`model_names`, or that of a file of weights or of a graph; returns it.

    Raises:
        ValueError: it is neither.
    """
    if name not in model_names() and not name.endswith(FILES):
        raise ValueError(f"expected one of {', '.join(model_names())}, or a file *{' or *'.join(FILES)}")
    return name


ModelName = Annotated[str, AfterValidator(known_model)]
"""Type of a field that names a predictor."""


@configuration
class PredictorConfig:
    """Parameters of the predictor stage that all predictors share.

    Attributes:
        model: default, or another installed predictor; or a file of weights (*.safetensors) or of a graph (*.onnx).
        roi_m: radius around agents off their log within which agents are looked at; 0 is the scenario's.
        forecast_all: whether all agents of interest are forecast, and not only those whose forecast is read.
        modes: greatest number of manoeuvres of an agent that are forecast besides the most probable one, each with a
            probability of at least 0.05; only by models that kernels run.
        along_lanes: whether learned models forecast along lanes that bend.
    """

    model: ModelName = DEFAULT_MODEL
    roi_m: NonNegative[Length] = 0.0
    forecast_all: Flag = False
    modes: NonNegative[Whole] = 3
    along_lanes: Flag = True


def predictor_stage(read: ParameterOverrides) -> Callable[[str, Setting], Predictor]:
    """Read the parameters of all installed predictors; the result builds that of a run for its policy and scenario."""
    config = read(PredictorConfig())
    factories = {name: plugins.load(plugins.PREDICTORS, name).read(read) for name in model_names()}
    wanted = Wanted.ALL if config.forecast_all else Wanted.READ

    def build(policy: str, scenario: Setting) -> Predictor:
        if not config.forecast_all and drives_by_region(policy):
            return NoPredictor()
        scope = Scope(config.roi_m or scenario.roi_m, wanted, config.modes, config.along_lanes)
        predictor: Predictor = (factories.get(config.model) or _of_file(config.model))(scenario, scope)
        return predictor

    return build


def make_predictor(
    model: str, scenario: Setting, wanted: Wanted = Wanted.READ, roi_m: float = 0.0, modes: int = 0
) -> Predictor:
    """Returns the predictor called `model`, or that in a file of weights or of a graph, for a run of `scenario`.

    `roi_m` [m] replaces the scenario's, where it is not 0; parameters are the defaults. Raises an InputError if there
    is none of that name, or its weights cannot be used.
    """
    try:
        known_model(model)
    except ValueError as error:
        raise InputError(f"predictor: parameter model is {model!r}, {error}") from error
    kind = plugins.load(plugins.PREDICTORS, model) if model in model_names() else _of_file(model)
    make = kind.read(ParameterOverrides(PREDICTOR, {}))
    predictor: Predictor = make(scenario, Scope(roi_m or scenario.roi_m, wanted, modes))
    return predictor


def weights_on(model: str, lane_map: LaneMap | None) -> str:
    """Returns the weights with which `model` forecasts on the net of `lane_map`: `default` has others on streets."""
    on_streets = model == DEFAULT_MODEL and lane_map is not None and of_streets(lane_map.lanes)
    return ON_STREETS if on_streets else model


def network(model: str) -> Network:
    """Returns the trained model `model`, compiled; by torch where it has neither kernels nor a graph.

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

    ready = compiled(model)
    if ready is not None:
        return ready
    if not plugins.installed(plugins.NETWORKS):
        raise InputError(
            f"{model}: weights of a model that comes without a graph need a package that runs them, such as LitSim's "
            "own for training; its `export` makes a graph of them"
        )
    eager: Network = plugins.load(plugins.NETWORKS, plugins.names(plugins.NETWORKS)[0])(model)
    return eager


def _of_file(file: str) -> type[Learned]:
    """Returns the class of the predictor in a file."""
    return type("OfFile", (Learned,), {"model": file})
