"""Parameters of the policy `simnet`, without the imports of its code, which runs with other policies do not need."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Literal

from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import configuration


@configuration
class SimnetConfig:
    """Which network drives.

    Attributes:
        backbone: `small`, which is packaged, on a raster of 96 x 48 cells of 1 m; or the paper's `resnet50`, on 224 x
            224 cells of 0.5 m, with weights from ``litsim_research train simnet``.
        weights: file of the network; empty for the packaged one.
    """

    backbone: Literal["small", "resnet50"] = "small"
    weights: str = ""

    def file(self) -> Path:
        """Returns the file of the network.

        Raises:
            InputError: `weights` is not a file for this backbone.
        """
        if not self.weights and self.backbone != "small":
            raise InputError(
                f"policy: parameter simnet.weights is empty, expected a file for backbone {self.backbone}: none comes "
                f"with LitSim; litsim_research train simnet makes one"
            )
        path = Path(self.weights) if self.weights else shipped_weights()
        expected = ".safetensors" if self.backbone == "small" else ".onnx"
        if path.suffix != expected:
            raise InputError(
                f"policy: parameter simnet.weights is {self.weights!r}, expected a file {expected} for backbone "
                f"{self.backbone}"
            )
        return path


def shipped_weights() -> Path:
    """Returns the packaged weights, of the small backbone."""
    return Path(str(resources.files("litsim_research").joinpath("weights/simnet.safetensors")))
