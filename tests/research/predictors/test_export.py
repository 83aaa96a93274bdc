"""Graphs answer as the models of torch do that they were made of."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from litsim_predictor.inference import GRAPHS, SHIPPED
from litsim_predictor.inference.compiled import FORMAT, CompiledNetwork
from litsim_predictor.inference.contract import MANEUVERS, AgentInputs, Network
from litsim_predictor.inference.features import agent_inputs
from litsim_predictor.inference.joint.network import JointNetwork
from litsim_predictor.inference.networks import compiled
from litsim_predictor.inference.weights import packaged, read_weights
from litsim_research.predictors.data.scenes import inputs_batch
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.eager import EagerNetwork
from litsim_research.predictors.export import write_graph
from litsim_research.predictors.models.registry import build
from litsim_research.predictors.models.weights import load_model, save_model
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import Scenario

WITHIN_M = 1e-4
# Who is on the border of two cells of a grid is in either of them, by the last bit.
APART = {"default": 0.0, "paper": 0.0, "cs_lstm": 0.05, "bat": 0.05}


def scenes(scenario: Scenario) -> Iterator[AgentInputs]:
    """What a predictor sees of whole frames and of a few agents, some of whom have just appeared."""
    tracks = Tracks.from_table(scenario.name, scenario.recording.table, scenario.net_path)
    for frame in tracks.frames[[0, 7, len(tracks.frames) // 2]]:
        everybody = tracks.rows_at(int(frame))
        for agents in (1, 2, 12, 13, 14, len(everybody)):
            rows = everybody[:agents]
            past, observed = tracks.history(rows)
            yield agent_inputs(tracks.motion[past], observed, tracks.size[rows], tracks.heading[rows], tracks.raster)


def compiled_network(name: str) -> Network:
    network = compiled(name)
    assert network is not None
    return network


def assert_answers_agree(a: Network, b: Network, scenario: Scenario, apart: float = 0.0) -> None:
    """All but a share `apart` of every second agent of every scene have the same answers."""
    for inputs in scenes(scenario):
        asked = np.arange(0, len(inputs.state), 2)
        one, other = a(inputs, asked), b(inputs, asked)
        n = len(asked)
        differs = np.zeros(n, np.bool_)
        for name, values in vars(one).items():
            if name != "further":  # of which torch and graphs answer none
                differs |= (np.abs(values - getattr(other, name)).reshape(n, -1) >= WITHIN_M).any(axis=1)
        assert differs.sum() <= apart * n, np.flatnonzero(differs)


@pytest.mark.parametrize("name", SHIPPED)
def test_graphs_answer_as_torch_does(name: str) -> None:
    assert_answers_agree(
        compiled_network(name), EagerNetwork(load_model(name)[0], name), Scenario.load("demo"), APART[name]
    )


@pytest.mark.parametrize("name", GRAPHS)
def test_shipped_graphs_hold_no_weights_and_say_of_what_they_are(name: str) -> None:
    graph = onnx.load(packaged("graphs") / f"{name}.onnx", load_external_data=False)
    told = {entry.key: entry.value for entry in graph.metadata_props}
    weights = read_weights(name)
    assert (told["model"], json.loads(told["parameters"])) == (
        weights.provenance.model,
        weights.provenance.parameters,
    )
    apart = {tensor.name for tensor in graph.graph.initializer if tensor.data_location == onnx.TensorProto.EXTERNAL}
    assert apart == {f"network.{key}" for key in weights.arrays}


DIRECT = {"history": "direct"}
MINE = [
    DIRECT | {"hidden": 32, "layers": 1, "neighbours": 4, "traffic": True},
    DIRECT | {"layers": 3, "neighbours": 20, "reach": 30.0, "heads": 4, "map_channels": 8, "history_width": 32},
    {"attention": "states", "reach": 60.0, "neighbours": 64, "decoder": "recurrent"},
    {"hidden": 32, "history_channels": 2},
]
"""Configurations of joint predictors of one's own; the last two have no kernels."""


@pytest.mark.parametrize("parameters", MINE)
def test_models_of_ones_own_run_by_kernels_or_torch_or_as_a_graph_of_their_own(
    parameters: dict[str, Any], tmp_path: Path
) -> None:
    torch.manual_seed(0)
    _, provenance = load_model("default")
    provenance = replace(provenance, parameters=parameters)
    model = build("joint", provenance.parameters, "test").eval()
    weights = tmp_path / "mine.safetensors"
    save_model(model, provenance, weights)
    network = compiled(str(weights))
    if parameters in MINE[-2:]:
        assert network is None  # no graph of that shape is shipped
    else:
        assert isinstance(network, JointNetwork)
        assert_answers_agree(network, EagerNetwork(model, "mine"), Scenario.load("demo"))
    write_graph(*load_model(str(weights)), tmp_path / "mine.onnx", weights=True)
    assert_answers_agree(CompiledNetwork(tmp_path / "mine.onnx"), EagerNetwork(model, "mine"), Scenario.load("demo"))


OWN = {"maneuver": (9,), "mean": (25, 2), "scale": (25, 2), "correlation": (25,)}


def own_graph(path: Path, asked: int = TensorProto.INT64, **shapes: tuple[int, ...]) -> Path:
    """A graph that answers zeros, of the shapes of an exported one unless told otherwise."""
    nodes, constants = [helper.make_node("Shape", ["asked"], ["many"])], []
    for name, shape in (OWN | shapes).items():
        constants.append(numpy_helper.from_array(np.array(shape, np.int64), f"rest of {name}"))
        nodes.append(helper.make_node("Concat", ["many", f"rest of {name}"], [f"shape of {name}"], axis=0))
        nodes.append(helper.make_node("ConstantOfShape", [f"shape of {name}"], [name]))
    given = [helper.make_tensor_value_info("asked", asked, ["n"])]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in (OWN | shapes)]
    graph = helper.make_graph(nodes, "own", given, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"format": FORMAT})
    onnx.save(model, path)
    return path


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"mean": (25, 3)}, "output mean is float32 of shape (1, 25, 3), expected float32 of shape (1, 25, 2)"),
        ({"maneuver": (5, 2)}, "output maneuver is float32 of shape (1, 5, 2), expected float32 of shape (1, 9)"),
        ({"asked": TensorProto.INT32}, "ONNX Runtime cannot run it: "),
        ({"codes": (7, 8)}, "output codes has shape ["),
        ({"speed": (1,)}, "outputs are maneuver, mean, scale, correlation, speed, expected maneuver, mean, scale, "),
    ],
)
def test_what_is_wrong_with_a_graph_of_ones_own_is_named(wrong: dict[str, Any], expected: str, tmp_path: Path) -> None:
    inputs = next(scenes(Scenario.load("demo")))
    CompiledNetwork(own_graph(tmp_path / "right.onnx"))(inputs, np.arange(1))
    file = own_graph(tmp_path / "wrong.onnx", **wrong)
    with pytest.raises(InputError) as raised:
        CompiledNetwork(file)(inputs, np.arange(1))
    assert str(raised.value).startswith(f"{file}: {expected}") and "\n" not in str(raised.value)


def test_a_graph_without_a_choice_of_manoeuvres_is_named(tmp_path: Path) -> None:
    file = own_graph(tmp_path / "own.onnx")
    with pytest.raises(InputError, match="decodes the most probable manoeuvre alone") as raised:
        CompiledNetwork(file).of_maneuver(next(scenes(Scenario.load("demo"))), np.arange(1), 3)
    assert str(raised.value).startswith(f"{file}: ")


@pytest.mark.parametrize("name", GRAPHS)
def test_graphs_decode_manoeuvres_as_torch_does(name: str) -> None:
    network, model = compiled_network(name), load_model(name)[0].eval()
    assert isinstance(network, CompiledNetwork)
    inputs = next(scenes(Scenario.load("demo")))
    with torch.inference_mode():
        everything = model(inputs_batch([inputs]), "all")
    for maneuver in range(len(MANEUVERS)):
        answer = network.of_maneuver(inputs, np.arange(1), maneuver)
        assert np.abs(answer.mean[0] - everything.mean[0, 0, maneuver].numpy()).max() < WITHIN_M
