"""A learned model as a graph of operators (ONNX) that ONNX Runtime compiles for the processor: no torch.

The graphs that come with the package hold no weights. They are given those of the safetensors file of the same name,
or of any file of a model of the same kind and configuration, so that no second copy can differ. A graph that a user
exports holds its weights. `litsim_research export` writes both.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as failures

from litsim_predictor.inference import SHIPPED
from litsim_predictor.inference.contract import (
    HORIZON,
    MANEUVERS,
    AgentFutures,
    AgentInputs,
)
from litsim_predictor.inference.map_memory import MapMemory
from litsim_predictor.inference.weights import Weights
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import IntArray
from litsim_sim.io.input_files import require_file

FORMAT = "litsim_predictor/graph/2"
MOST_PROBABLE = -1
"""Input `decode` of a graph where the most probable manoeuvre is to be decoded."""
INPUTS = (
    *("position", "heading", "history", "observed", "state", "traffic"),
    *("asked", "decode"),
    *("raster", "known", "code_of"),
)
"""Inputs that a graph may have: fields of :class:`.contract.AgentInputs`, places relative to the first agent's; the
rows to answer for, and the manoeuvre of each; and the map, see :class:`.map_memory.MapCodes`."""
OUTPUTS = ("maneuver", "mean", "scale", "correlation")
"""Outputs of a graph: the fields of :class:`.contract.AgentFutures`."""
SHAPES = ((len(MANEUVERS),), (HORIZON, 2), (HORIZON, 2), (HORIZON,))
"""Their shapes for one agent, all of single precision."""
CODES = "codes"
"""Further output of a graph that sees the map: its encodings of the rasters, to be cached."""
PARAMETER = "network."
"""Prefix of the names of the weights in a graph."""
BROKEN = (
    failures.Fail,
    failures.InvalidArgument,
    failures.InvalidGraph,
    failures.InvalidProtobuf,
    failures.NotImplemented,
    failures.RuntimeException,
)
"""Errors of ONNX Runtime about a file, or about what is given to its network."""


def open_graph(path: Path, weights: Mapping[str, np.ndarray[Any, Any]]) -> onnxruntime.InferenceSession:
    """Returns a session in which equal inputs give equal bits in every process.

    Args:
        path: of the graph.
        weights: by name, of a graph that holds none.

    Raises:
        InputError: the file is damaged.
    """
    options = onnxruntime.SessionOptions()
    # Scenes are small, so that a second thread mostly costs waiting; and rounding depends on the number of threads.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # errors are raised, and need not be printed
    values = [onnxruntime.OrtValue.ortvalue_from_numpy(array) for array in weights.values()]
    options.add_external_initializers([PARAMETER + name for name in weights], values)
    try:
        return onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    except BROKEN as error:
        raise InputError(f"{path}: ONNX Runtime refuses it: {first_line(error)}; expected an ONNX file") from error


class CompiledNetwork:
    """A graph for inference; equal inputs give equal bits in every process.

    Args:
        path: of the graph.
        weights: for a graph that holds none.

    Raises:
        InputError: the file is missing or damaged, or is not a graph of a learned predictor.

    Attributes:
        source, sees_signals: see :class:`.contract.Network`; a graph alone does not tell, and sees none.
    """

    def __init__(self, path: Path, weights: Weights | None = None) -> None:
        require_file(path, "graph", f"; shipped are {', '.join(SHIPPED)}")
        self._session = open_graph(path, {} if weights is None else weights.arrays)
        self.source = str(path if weights is None else weights.path)
        self.sees_signals = weights is not None and weights.provenance.sees_signals
        kind = self._session.get_modelmeta().custom_metadata_map.get("format")
        if kind != FORMAT:
            raise InputError(
                f"{path}: metadata format is {kind!r}, expected {FORMAT!r}: a file written by litsim_research export"
            )
        self._asks = [node.name for node in self._session.get_inputs()]
        answers = {node.name: node.shape for node in self._session.get_outputs()}
        self._outputs = list(answers)
        if self._outputs not in ([*OUTPUTS], [*OUTPUTS, CODES]):
            raise InputError(
                f"{path}: outputs are {', '.join(answers)}, expected {', '.join(OUTPUTS)}, and {CODES} if it sees maps"
            )
        if odd := sorted(set(self._asks) - set(INPUTS)):
            raise InputError(f"{path}: inputs {', '.join(odd)} are unknown, expected some of {', '.join(INPUTS)}")
        self._maps = None
        if CODES in answers:
            width = answers[CODES][-1]
            if len(answers[CODES]) != 2 or not isinstance(width, int):
                raise InputError(f"{path}: output {CODES} has shape {answers[CODES]}, expected ['new', a fixed width]")
            self._maps = MapMemory(width)

    def __call__(self, inputs: AgentInputs, asked: IntArray, modes: int = 0) -> AgentFutures:  # noqa: ARG002 - of the protocol
        """See :class:`.contract.Network`.

        Raises:
            InputError: the graph does not take these inputs, or its outputs are not of the contract's shapes and type.
        """
        return self.of_maneuver(inputs, asked, MOST_PROBABLE)

    def of_maneuver(self, inputs: AgentInputs, asked: IntArray, maneuver: int) -> AgentFutures:
        """See :class:`.contract.NetworkOfManeuvers`.

        Raises:
            InputError: see :meth:`__call__`; or the graph decodes the most probable manoeuvre alone.
        """
        if maneuver != MOST_PROBABLE and "decode" not in self._asks:
            raise InputError(
                f"{self.source}: the graph decodes the most probable manoeuvre alone, expected one with the input "
                "decode; export it anew"
            )
        place = inputs.frame[:, :2] - inputs.frame[:1, :2]
        arrays = {
            "position": place.astype(np.float32),
            "heading": inputs.frame[:, 2].astype(np.float32),
            "history": inputs.history,
            "observed": inputs.observed,
            "state": inputs.state,
            "traffic": inputs.traffic,
            "asked": asked,
            "decode": np.full(len(asked), maneuver, np.int64),
        }
        if self._maps is not None:
            maps = self._maps.look_up(inputs.raster)
            arrays |= {"raster": maps.new, "known": maps.known, "code_of": maps.code_of}
        try:
            answer = self._session.run(self._outputs, {name: arrays[name] for name in self._asks})
        except BROKEN as error:
            raise InputError(f"{self.source}: ONNX Runtime cannot run it: {first_line(error)}") from error
        if self._maps is not None:
            self._maps.keep(maps, answer.pop())
        for name, values, shape in zip(OUTPUTS, answer, SHAPES, strict=True):
            if values.dtype != np.float32 or values.shape != (len(asked), *shape):
                raise InputError(
                    f"{self.source}: output {name} is {values.dtype} of shape {values.shape}, expected float32 of "
                    f"shape {(len(asked), *shape)}"
                )
        return AgentFutures(*answer)


def first_line(error: Exception) -> str:
    """Returns the first line of an error's message."""
    return str(error).strip().splitlines()[0]
