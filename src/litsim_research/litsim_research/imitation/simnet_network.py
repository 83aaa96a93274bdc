"""SimNet for training in torch; :mod:`litsim_research.baselines.simnet.network` runs it without torch."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from litsim_research.baselines.simnet.output import FORMAT, OUTPUTS, SMALL_HIDDEN, SMALL_WIDTHS
from litsim_research.baselines.simnet.raster import CHANNELS, SMALL
from litsim_research.predictors.checkpoint import save_weights
from litsim_sim.core.scene import FloatArray


class SimNet(nn.Module):
    """A backbone from a raster to normalised outputs.

    Attributes:
        middle, spread: (OUTPUTS,) mean and standard deviation of the targets [m], [rad].
        unit: (OUTPUTS,) unit of the errors in the loss [m], [rad].
    """

    middle: Tensor
    spread: Tensor
    unit: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.backbone = small()
        self.register_buffer("middle", torch.zeros(OUTPUTS))
        self.register_buffer("spread", torch.ones(OUTPUTS))
        self.register_buffer("unit", torch.ones(OUTPUTS))

    def forward(self, rasters: Tensor) -> Tensor:
        """Normalised outputs (b, OUTPUTS) for rasters (b, CHANNELS, rows, columns)."""
        values: Tensor = self.backbone(rasters)
        return values

    def physical(self, rasters: Tensor) -> Tensor:
        """Returns outputs (b, OUTPUTS) in metres and radians."""
        return self(rasters) * self.spread + self.middle

    def scale_to(self, futures: FloatArray, units: FloatArray) -> None:
        """Set mean and spread to those of `futures` (k, OUTPUTS), and the units of errors to `units` (OUTPUTS,)."""
        self.unit.copy_(torch.from_numpy(units))
        self.middle.copy_(torch.from_numpy(futures.mean(axis=0)))
        self.spread.copy_(torch.from_numpy(np.maximum(futures.std(axis=0), 1e-6)))


def small() -> nn.Sequential:
    """Four convolutions, each of which halves the raster, and two linear layers; fast without a GPU."""
    layers: list[nn.Module] = []
    before = CHANNELS
    for width in SMALL_WIDTHS:
        layers += [nn.Conv2d(before, width, 3, stride=2, padding=1), nn.ReLU()]
        before = width
    halved = 2 ** len(SMALL_WIDTHS)
    cells = (SMALL.rows // halved) * (SMALL.columns // halved)
    layers += [nn.Flatten(), nn.Linear(before * cells, SMALL_HIDDEN), nn.ReLU(), nn.Linear(SMALL_HIDDEN, OUTPUTS)]
    return nn.Sequential(*layers)


def save(network: SimNet, path: Path, about: dict[str, str]) -> None:
    """Write the network for driving, as a safetensors file; `about` is metadata on the origin of the weights.

    Raises:
        Unwritable: the file cannot be written; what was there is kept.
    """
    network = copy.deepcopy(network).cpu().eval()
    save_weights(_tensors(network), {"format": FORMAT, **about}, path)


def _tensors(network: SimNet) -> dict[str, Tensor]:
    """Weights for :class:`litsim_research.baselines.simnet.network.SimnetNetwork`, outputs in metres and radians."""
    found: dict[str, Tensor] = {}
    number = 0
    for layer in network.backbone:
        if isinstance(layer, nn.Conv2d):
            found[f"convolution.{number}.weight"] = layer.weight.detach().flatten(1).contiguous()
            found[f"convolution.{number}.bias"] = layer.bias.detach().clone()  # type: ignore[union-attr]
            number += 1
    hidden, last = (layer for layer in network.backbone if isinstance(layer, nn.Linear))
    found["hidden.weight"], found["hidden.bias"] = hidden.weight.detach().T.contiguous(), hidden.bias.detach().clone()
    found["last.weight"] = (last.weight.detach() * network.spread[:, None]).T.contiguous()
    found["last.bias"] = last.bias.detach() * network.spread + network.middle
    return found
