"""The network of policy C: a small MLP, read from a safetensors file and applied with numpy.

The policy node needs no torch: :mod:`litsim_research.policies.network` is the same network for training in torch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from litsim_policy.driving.action import ACTIONS
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.motion.network_file import Perceptron, layer_arrays, read_network
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray

HIDDEN = 128
LAYERS = ("hidden0", "hidden1", "mean")
FORMAT = "litsim policy C, 1"
PACKAGED = ("critic",)
PARSED: dict[str, Callable[[str], Any]] = {
    "slots": int,
    "sight": float,
    "ahead": {"True": True, "False": False}.__getitem__,
}
"""How each field of the observation is read from a file's metadata."""
RETIRED = {"observation.arrange": "sector", "observation.residual": "False"}
"""Fields of the metadata that only files of earlier versions have, with the value that is still driven with."""


@dataclass(frozen=True)
class PolicyNetwork(Perceptron):
    """The mean action as a function of the observation: two hidden layers, tanh throughout.

    Attributes:
        observation: with which the network was trained.
    """

    observation: ObservationConfig

    @classmethod
    def load(cls, path: Path) -> PolicyNetwork:
        """Read what :func:`litsim_research.policies.network.save` has written.

        Raises:
            InputError: the file is missing, damaged, or holds another network than this version drives with.
        """
        metadata, tensors = read_network(path, "policy C", FORMAT)
        observation = _observation(metadata, path)
        sizes = (observation.size, HIDDEN, HIDDEN, len(ACTIONS))
        return cls(*layer_arrays(path, tensors, LAYERS, sizes), observation)

    def mean(self, observation: FloatArray) -> FloatArray:
        """Returns mean actions (m, 3) in [-1, 1] for observations (m, size)."""
        return np.tanh(self.outputs(observation))


class ForeignPolicy:
    """A network of an ONNX file, which another library has trained in the environment `litsim/Takeover-v0`.

    Attributes:
        observation: that of the environment.
    """

    observation = ObservationConfig()

    def __init__(self, path: Path) -> None:
        """Read the file; raises as :class:`litsim_policy.motion.network_graph.NetworkGraph`."""
        from litsim_policy.motion.network_graph import NetworkGraph  # imports ONNX Runtime

        self._graph = NetworkGraph(path, self.observation.size, len(ACTIONS))

    def mean(self, observation: FloatArray) -> FloatArray:
        """Returns actions (m, 3) in [-1, 1] for observations (m, size)."""
        return self._graph.actions(observation)


def load_policy(path: Path) -> PolicyNetwork | ForeignPolicy:
    """Returns the network of a file of weights, or of an ONNX file; raises InputError if it cannot be used."""
    return ForeignPolicy(path) if path.suffix == ".onnx" else PolicyNetwork.load(path)


def shipped_weights(name: str) -> Path:
    """Returns one of the :data:`PACKAGED` weights files of policy C."""
    return Path(str(resources.files("litsim_policy").joinpath(f"weights/policy_c_{name}.safetensors")))


def _observation(metadata: dict[str, str], path: Path) -> ObservationConfig:
    """Returns the observation in a file's metadata; older files lack fields."""
    for name, expected in RETIRED.items():
        if (given := metadata.get(name, expected)) != expected:
            raise InputError(f"{path}: metadata {name} is {given!r}, expected {expected!r}")
    usual = {"observation.ahead": "False"}
    values = {field: (usual | metadata).get(f"observation.{field}", "") for field in vars(ObservationConfig())}
    try:
        return ObservationConfig(**{field: parse(values[field]) for field, parse in PARSED.items()})
    except (ValueError, KeyError) as error:
        found = ", ".join(f"{field} {value!r}" for field, value in values.items())
        raise InputError(
            f"{path}: metadata observation is {found}, expected slots a number, sight in "
            "metres, and ahead True or False"
        ) from error
