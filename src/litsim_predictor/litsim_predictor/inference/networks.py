"""Trained models for inference without torch: by kernels, or by a graph of operators."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from litsim_predictor.inference import GRAPHS
from litsim_predictor.inference.contract import Network
from litsim_predictor.inference.joint.network import JointNetwork, runs
from litsim_predictor.inference.weights import packaged, read_weights


def compiled(name: str) -> Network | None:
    """The graph of a file ``.onnx``; or a shipped model, or one of a file of weights, by kernels or as a shipped graph.

    Returns:
        None where weights are of a model that has no kernels and for which no graph is shipped.

    Raises:
        InputError: the file cannot be used.
    """
    if name.endswith(".onnx"):
        return _graph(Path(name))
    weights = read_weights(name)
    if runs(weights):
        return JointNetwork(weights)
    for shipped in (name,) if name in GRAPHS else GRAPHS:
        like = read_weights(shipped)
        same = (like.provenance.model, like.provenance.parameters)
        if same == (weights.provenance.model, weights.provenance.parameters):
            weights.check({key: array.shape for key, array in like.arrays.items()})
            return _graph(packaged("graphs") / f"{shipped}.onnx", weights)
    return None


def _graph(*arguments: Any) -> Network:
    """See :class:`.compiled.CompiledNetwork`, without which ONNX Runtime need not be imported."""
    from litsim_predictor.inference.compiled import CompiledNetwork

    return CompiledNetwork(*arguments)
