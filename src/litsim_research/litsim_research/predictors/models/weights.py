"""Saving and loading of the weights of torch models; see :mod:`litsim_predictor.inference.weights` for the files."""

from __future__ import annotations

import json
from pathlib import Path

import torch

from litsim_predictor.inference.weights import FORMAT, Provenance, read_weights
from litsim_research.predictors.checkpoint import save_weights
from litsim_research.predictors.models.model import SceneModel
from litsim_research.predictors.models.registry import build


def save_model(model: SceneModel, provenance: Provenance, path: Path) -> None:
    """Write the weights of `model` to `path`, whole or not at all.

    Raises:
        InputError: see :func:`litsim_sim.io.files.replacing`.
    """
    metadata = {"format": FORMAT, "provenance": json.dumps(vars(provenance), sort_keys=True)}
    save_weights(model.state_dict(), metadata, path)


def load_model(name: str) -> tuple[SceneModel, Provenance]:
    """Returns the model of shipped weights or of a file of weights, ready to predict, and their provenance.

    Raises:
        InputError: the file is missing, is damaged, or does not contain weights of a known model.
    """
    weights = read_weights(name)
    model = build(weights.provenance.model, weights.provenance.parameters, str(weights.path))
    weights.check({key: tuple(tensor.shape) for key, tensor in model.state_dict().items()})
    model.load_state_dict({key: torch.from_numpy(array) for key, array in weights.arrays.items()})
    model.sees_signals = weights.provenance.sees_signals
    return model.eval(), weights.provenance
