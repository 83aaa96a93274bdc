"""Trained weights: safetensors files whose metadata says which model they are of and where they come from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from litsim_predictor.learned import SHIPPED
from litsim_predictor.learned.models.model import SceneModel
from litsim_predictor.learned.models.registry import build
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing

FORMAT = "litsim_predictor/1"


@dataclass(frozen=True)
class Provenance:
    """What made a file of weights.

    Attributes:
        model, parameters: kind and configuration of the model; see :func:`.registry.build`.
        command: that trained it.
        training: the whole training configuration.
        manifest: what it was trained on: files with digests, and samples by source and part.
        figures: what it measured in training.
    """

    model: str
    parameters: dict[str, Any]
    command: str
    training: dict[str, Any]
    manifest: dict[str, Any]
    figures: dict[str, Any]


def save_model(model: SceneModel, provenance: Provenance, path: Path) -> None:
    """Write weights to `path`, whole or not at all.

    Raises:
        InputError: see :func:`litsim_sim.io.files.replacing`.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}
    metadata = {"format": FORMAT, "provenance": json.dumps(vars(provenance), sort_keys=True)}
    with replacing(path) as new:
        new.write_bytes(save(tensors, metadata))


def load_model(name: str) -> tuple[SceneModel, Provenance]:
    """The model, ready to predict, of shipped weights or of a file, and what made it.

    Raises:
        InputError: the file is missing, is damaged, or holds no weights of a model that is known here.
    """
    path = _path_of(name)
    if not path.is_file():
        raise InputError(f"{path}: no such weights; shipped are {', '.join(SHIPPED)}")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (no mapping)
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(f"{path}: damaged weights: {error}; expected a safetensors file") from error
    provenance = _provenance(metadata, path)
    model = build(provenance.model, provenance.parameters, str(path))
    _check(model.state_dict(), tensors, path)
    model.load_state_dict(tensors)
    return model.eval(), provenance


def _path_of(name: str) -> Path:
    """The file of shipped weights `name`, or the file of that path."""
    shipped = Path(str(resources.files("litsim_predictor"))) / "weights" / f"{name}.safetensors"
    return shipped if name in SHIPPED else Path(name)


def _provenance(metadata: Mapping[str, str], path: Path) -> Provenance:
    if metadata.get("format") != FORMAT:
        raise InputError(f"{path}: metadata format is {metadata.get('format')!r}, expected {FORMAT!r}")
    try:
        return Provenance(**json.loads(metadata["provenance"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: metadata provenance is unreadable: {error!r}") from error


def _check(expected: Mapping[str, torch.Tensor], found: Mapping[str, torch.Tensor], path: Path) -> None:
    if set(expected) != set(found):
        odd = sorted(set(expected) ^ set(found))
        raise InputError(f"{path}: weights {odd} are missing or of no layer of the model")
    for name, tensor in found.items():
        if tensor.shape != expected[name].shape:
            shapes = f"{tuple(tensor.shape)}, expected {tuple(expected[name].shape)}"
            raise InputError(f"{path}: weights {name} have shape {shapes}")
        if not torch.isfinite(tensor).all():
            raise InputError(f"{path}: weights {name} hold values that are not finite")
