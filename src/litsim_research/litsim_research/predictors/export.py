"""Export of a trained model to an ONNX graph that runs without torch; see :mod:`litsim_predictor.inference.compiled`.

Models are exported by tracing; the networks are written so that one trace is valid for any number of agents.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from pathlib import Path

import onnx
import torch
from onnx import ModelProto, TensorProto, helper
from torch import Tensor, nn

from litsim_predictor.inference.compiled import CODES, FORMAT, INPUTS, MOST_PROBABLE, OUTPUTS, PARAMETER
from litsim_predictor.inference.contract import HISTORY, HISTORY_CHANNELS, HORIZON, STATE_CHANNELS
from litsim_predictor.inference.joint.units import TRAFFIC_CHANNELS
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS
from litsim_predictor.inference.weights import Provenance
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.models.joint import JointPredictor
from litsim_research.predictors.models.model import SceneModel
from litsim_sim.io.files import replacing

OPSET = 18
AGENTS, ASKED, NEW, KNOWN = 4, 2, 3, 1  # traced scene: agents, agents to predict, rasters to encode, cached map codes
WEIGHTS_APART = "weights"  # name of the external file that a graph without weights refers to; there is no such file


class OneScene(nn.Module):
    """`network` for one scene without padding, from and to tensors in the order of INPUTS and OUTPUTS."""

    def __init__(self, network: SceneModel) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return :data:`litsim_predictor.inference.compiled.OUTPUTS`, and CODES if the network reads the map."""
        position, heading, history, observed, state, traffic, asked, decode, raster, known, code_of = inputs
        present = observed[:, -1]
        batch = SceneBatch(
            position=position,
            heading=heading,
            history=history,
            observed=observed,
            state=state,
            traffic=traffic,
            raster=raster,
            agent=torch.ones_like(present),
            # The future is unknown, and the network does not read it.
            future=position.new_zeros(1, HORIZON, 2),
            future_known=present.new_zeros(1, HORIZON),
            maneuver=torch.zeros(1, dtype=torch.int64),
            target=torch.zeros_like(present),
        )
        codes = []
        if isinstance(self.network, JointPredictor):
            codes = [self.network.map(raster)]
            maps = torch.cat([known, *codes]).index_select(0, code_of)
            prediction = self.network(batch, decode, asked, maps)
        else:
            prediction = self.network(batch.in_batch(), decode[None], asked)
            prediction = Prediction(*(tensor.squeeze(0) for tensor in vars(prediction).values()))
        mean, scale, correlation = (v[:, 0] for v in (prediction.mean, prediction.scale, prediction.correlation))
        return prediction.maneuver.softmax(dim=-1), mean, scale, correlation, *codes


def write_graph(model: SceneModel, provenance: Provenance, path: Path, *, weights: bool) -> None:
    """Write `model` as an ONNX file, whole or not at all; without `weights`, they are supplied when it is loaded.

    Raises:
        InputError: see :func:`litsim_sim.io.files.replacing`.
    """
    graph = traced(model)
    if not weights:
        take_weights_out(graph)
    metadata = {"format": FORMAT, "model": provenance.model, "parameters": json.dumps(provenance.parameters)}
    if weights:
        metadata |= {"provenance": json.dumps(vars(provenance), sort_keys=True)}
    helper.set_model_props(graph, metadata)
    with replacing(path) as new:
        new.write_bytes(graph.SerializeToString())


def traced(model: SceneModel) -> ModelProto:
    """Returns the ONNX graph of `model`, with its weights."""
    outputs = (*OUTPUTS, CODES) if isinstance(model, JointPredictor) else OUTPUTS
    scene = (
        torch.rand(AGENTS, 2),
        torch.rand(AGENTS),
        torch.rand(AGENTS, HISTORY, HISTORY_CHANNELS),
        torch.ones(AGENTS, HISTORY, dtype=torch.bool),
        torch.rand(AGENTS, STATE_CHANNELS),
        torch.rand(AGENTS, TRAFFIC_CHANNELS),
        torch.arange(ASKED),
        torch.full((ASKED,), MOST_PROBABLE),
        torch.zeros(NEW, CHANNELS, ROWS, COLUMNS, dtype=torch.uint8),
        torch.zeros(KNOWN, model.map.width if isinstance(model, JointPredictor) else 1),
        torch.arange(AGENTS),
    )
    counts = dict.fromkeys(("asked", "decode", *OUTPUTS), "asked") | {"raster": "new", "known": "known", CODES: "new"}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        # The exporter warns of values that a trace takes for constants, such as numbers of channels. Tests verify that
        # the number of agents is not among them.
        warnings.simplefilter("ignore")
        file = Path(folder) / "traced.onnx"
        torch.onnx.export(
            OneScene(model.eval().cpu()),
            scene,
            file,
            input_names=INPUTS,
            output_names=outputs,
            dynamic_axes={name: {0: counts.get(name, "agents")} for name in (*INPUTS, *outputs)},
            opset_version=OPSET,
            do_constant_folding=False,  # keeps the weights as they are in the file; ONNX Runtime folds when it loads
            dynamo=False,  # the exporter that needs no package but onnx
        )
        graph = onnx.load(file)
    # These shapes were inferred from the traced scene; ONNX Runtime infers those that are valid for all scenes.
    graph.graph.ClearField("value_info")
    return graph


def take_weights_out(graph: ModelProto) -> None:
    """Remove the values of the model's parameters from `graph`, in place; names and shapes remain."""
    for tensor in graph.graph.initializer:
        if tensor.name.startswith(PARAMETER):
            tensor.ClearField("raw_data")
            tensor.data_location = TensorProto.EXTERNAL
            tensor.external_data.add(key="location", value=WEIGHTS_APART)
