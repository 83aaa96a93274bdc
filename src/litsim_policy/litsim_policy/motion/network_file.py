"""Files of small networks that drive without torch: safetensors with a format, and layers of known shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray


def read_network(path: Path, what: str, format_name: str) -> tuple[dict[str, str], dict[str, np.ndarray[Any, Any]]]:
    """Metadata and tensors of the file `path`, which should be of `what`.

    Raises:
        InputError: the file is missing or damaged, or its metadata name another format than `format_name`.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such weights of {what}")
    try:
        with safe_open(str(path), framework="numpy") as file:
            metadata = dict(file.metadata() or {})
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: not a readable safetensors file: {error}") from error
    if metadata.get("format") != format_name:
        raise InputError(f"{path}: metadata format is {metadata.get('format')!r}, expected {format_name!r}")
    return metadata, tensors


@dataclass(frozen=True)
class Perceptron:
    """Dense layers with tanh between them.

    Attributes:
        weights: (inputs, outputs) of each layer.
        biases: (outputs,) of each layer.
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]

    def outputs(self, observation: FloatArray) -> FloatArray:
        """Outputs (m, outputs) of the last layer; a row's outputs do not depend on other rows."""
        values = observation
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            # a stack of single rows: the blocking of a matrix product must not let agents change each other's last bits
            values = np.matmul(np.tanh(values)[:, None, :] if layer else values[:, None, :], weight)[:, 0] + bias
        return values


def layer_arrays(
    path: Path, tensors: Mapping[str, np.ndarray[Any, Any]], layers: Sequence[str], sizes: Sequence[int]
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Weights and biases, float64, of a :class:`Perceptron` with these `layers`, of `sizes`, one more than layers.

    Raises:
        InputError: one of them is missing, has another shape, or is not finite.
    """
    shapes: dict[str, tuple[int, ...]] = {f"{name}.weight": (sizes[i + 1], sizes[i]) for i, name in enumerate(layers)}
    shapes |= {f"{name}.bias": (sizes[i + 1],) for i, name in enumerate(layers)}
    for name, shape in shapes.items():
        actual = tensors[name].shape if name in tensors else "none"
        if actual != shape:
            raise InputError(f"{path}: tensor {name} has shape {actual}, expected {shape}")
        if not np.isfinite(tensors[name]).all():
            raise InputError(f"{path}: tensor {name} holds non-finite numbers, expected finite ones")
    weights = tuple(np.ascontiguousarray(tensors[f"{layer}.weight"].astype(np.float64).T) for layer in layers)
    return weights, tuple(tensors[f"{layer}.bias"].astype(np.float64) for layer in layers)
