"""Trained weights as arrays: safetensors files whose metadata name the model and the origin."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError
from safetensors import SafetensorError, safe_open

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference import ON_STREETS, SHIPPED
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import problems
from litsim_sim.core.quantities import configuration
from litsim_sim.io.input_files import require_file

FORMAT = "litsim_predictor/1"
Config = TypeVar("Config")


@configuration
class Provenance:
    """What made a file of weights.

    Attributes:
        model, parameters: kind and configuration of the model, with which :mod:`litsim_research.predictors` builds it.
        command: that trained it.
        training: the whole training configuration.
        manifest: its training data: files with digests, and samples by source and part.
        figures: its measures in training.
    """

    model: str
    parameters: dict[str, Any]
    command: str
    training: dict[str, Any]
    manifest: dict[str, Any]
    figures: dict[str, Any]

    @property
    def sees_signals(self) -> bool:
        """Whether closed stop lines were among the vehicles of some training data; see :mod:`.closed_lines`."""
        return any(source.get("signals") for source in self.training.get("data", []))


@dataclass(frozen=True)
class Weights:
    """The content of a file of weights.

    Attributes:
        arrays: by the names of the model's parameters.
        provenance: what made it.
        path: of the file, for errors.
    """

    arrays: Mapping[str, Float32Array]
    provenance: Provenance
    path: Path

    def parameters(self, config: type[Config]) -> Config:
        """Returns the configuration of the model, which is of the class `config`.

        Raises:
            InputError: see :func:`configured`.
        """
        return configured(config, self.provenance.parameters, str(self.path))

    def check(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """Refuse weights that are not those of a model with parameters of these `shapes`.

        Raises:
            InputError: a parameter is missing, is too many, or has another shape.
        """
        if set(shapes) != set(self.arrays):
            odd = sorted(set(shapes) ^ set(self.arrays))
            raise InputError(f"{self.path}: weights {odd} are missing or of no layer of the model")
        for name, array in self.arrays.items():
            if array.shape != shapes[name]:
                raise InputError(f"{self.path}: weights {name} have shape {array.shape}, expected {shapes[name]}")


def configured(config: type[Config], values: Mapping[str, Any], where: str) -> Config:
    """The configuration of the class `config` with `values`, which the file `where` gives as field `parameters`.

    Raises:
        InputError: a value is unknown, does not fit its field, or does not fit another.
    """
    try:
        return config(**values)
    except ValidationError as error:
        raise InputError(f"{where}: field parameters: {'; '.join(problems(error, config, values))}") from error


def weights_path(name: str) -> Path:
    """Returns the file of shipped weights `name`, or the file of that path."""
    return packaged("weights") / f"{name}.safetensors" if name in (*SHIPPED, ON_STREETS) else Path(name)


def packaged(folder: str) -> Path:
    """Returns a folder of files that come with this package."""
    return Path(str(resources.files("litsim_predictor"))) / folder


def read_weights(name: str) -> Weights:
    """Shipped weights, or those of a file.

    Raises:
        InputError: the file is missing or damaged, is a graph or of another format, or holds values that are not
            finite numbers of single precision.
    """
    path = weights_path(name)
    require_file(path, "weights", f"; shipped are {', '.join(SHIPPED)}")
    if path.suffix == ".onnx":
        raise InputError(f"{path}: a graph, expected the file *.safetensors of the weights that it was exported from")
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (no mapping)
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: damaged weights: {error}; expected a safetensors file") from error
    weights = Weights(arrays, _provenance(metadata, path), path)
    for key, array in arrays.items():
        if array.dtype != np.float32:
            raise InputError(f"{path}: weights {key} are of type {array.dtype}, expected float32")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: weights {key} hold values that are not finite")
    return weights


def _provenance(metadata: Mapping[str, str], path: Path) -> Provenance:
    if metadata.get("format") != FORMAT:
        raise InputError(f"{path}: metadata format is {metadata.get('format')!r}, expected {FORMAT!r}")
    try:
        fields = json.loads(metadata["provenance"])
        return Provenance(**fields)
    except ValidationError as error:
        raise InputError(f"{path}: metadata provenance: {'; '.join(problems(error, Provenance, fields))}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: metadata provenance is unreadable: {error!r}") from error
