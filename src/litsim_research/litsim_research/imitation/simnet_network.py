"""SimNet for training in torch; :mod:`litsim_research.baselines.simnet.network` runs it without torch."""

from __future__ import annotations

import copy
import warnings
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from litsim_research.baselines.simnet.output import FORMAT, OUTPUTS, SMALL_HIDDEN, SMALL_WIDTHS
from litsim_research.baselines.simnet.raster import CHANNELS, PAPER, SMALL, RasterShape
from litsim_research.predictors.checkpoint import save_weights
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.files import replacing

Backbone = Literal["small", "resnet50"]
SHAPES: dict[Backbone, RasterShape] = {"small": SMALL, "resnet50": PAPER}
OPSET = 18


class SimNet(nn.Module):
    """A backbone from a raster to normalised outputs.

    Attributes:
        middle, spread: (OUTPUTS,) mean and standard deviation of the targets [m], [rad].
        unit: (OUTPUTS,) unit of the errors in the loss [m], [rad].
    """

    middle: Tensor
    spread: Tensor
    unit: Tensor

    def __init__(self, backbone: Backbone) -> None:
        super().__init__()
        self.backbone_name: Backbone = backbone
        self.backbone: nn.Module = small() if backbone == "small" else ResNet50(CHANNELS, OUTPUTS)
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
    """Write the network for driving: a safetensors file for the small backbone, otherwise an ONNX graph.

    The suffix of `path` is that of :func:`ending`; `about` is metadata on the origin of the weights.

    Raises:
        Unwritable: the file cannot be written; what was there is kept.
    """
    network = copy.deepcopy(network).cpu().eval()
    metadata = {"format": FORMAT, "backbone": network.backbone_name, **about}
    if network.backbone_name == "small":
        save_weights(_small_tensors(network), metadata, path)
    else:
        with replacing(path) as new:
            _export(network, new, metadata)


def ending(backbone: Backbone) -> str:
    """Suffix of the file that :func:`save` writes for this backbone."""
    return ".safetensors" if backbone == "small" else ".onnx"


def _small_tensors(network: SimNet) -> dict[str, Tensor]:
    """Weights for :class:`litsim_research.baselines.simnet.network.SmallNetwork`, outputs in metres and radians."""
    assert isinstance(network.backbone, nn.Sequential)
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


class _Physical(nn.Module):
    """A network with outputs in metres and radians, for export."""

    def __init__(self, network: SimNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, raster: Tensor) -> Tensor:
        return self.network.physical(raster)


def _export(network: SimNet, path: Path, about: dict[str, str]) -> None:
    """Write `network` as an ONNX graph for one raster at a time."""
    import onnx
    from onnx import helper

    shape = SHAPES[network.backbone_name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecation warnings of the exporter
        torch.onnx.export(
            _Physical(network),
            (torch.zeros(1, CHANNELS, shape.rows, shape.columns),),
            str(path),
            input_names=("raster",),
            output_names=("future",),
            opset_version=OPSET,
            dynamo=False,  # the exporter that needs no package but onnx
        )
    graph = onnx.load(path)
    helper.set_model_props(graph, about)
    onnx.save(graph, path)


BLOCKS = (3, 4, 6, 3)  # in each of the four stages
WIDTHS = (64, 128, 256, 512)  # channels within the blocks of each stage
EXPANSION = 4  # ratio of channels after a block to those within


class Bottleneck(nn.Module):
    """Three convolutions and a shortcut; the middle one has the stride (version 1.5, as in torchvision)."""

    def __init__(self, before: int, width: int, stride: int) -> None:
        super().__init__()
        after = EXPANSION * width
        self.conv1, self.bn1 = nn.Conv2d(before, width, 1, bias=False), nn.BatchNorm2d(width)
        self.conv2, self.bn2 = nn.Conv2d(width, width, 3, stride, 1, bias=False), nn.BatchNorm2d(width)
        self.conv3, self.bn3 = nn.Conv2d(width, after, 1, bias=False), nn.BatchNorm2d(after)
        self.downsample: nn.Module | None = None
        if stride != 1 or before != after:
            self.downsample = nn.Sequential(nn.Conv2d(before, after, 1, stride, bias=False), nn.BatchNorm2d(after))

    def forward(self, values: Tensor) -> Tensor:
        """Map values (b, before, rows, columns) to (b, EXPANSION * width, rows / stride, columns / stride)."""
        beside = values if self.downsample is None else self.downsample(values)
        inner = torch.relu(self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(values))))))
        return torch.relu(self.bn3(self.conv3(inner)) + beside)


class ResNet50(nn.Module):
    """A network from images (b, channels, rows, columns) to (b, outputs)."""

    def __init__(self, channels: int, outputs: int) -> None:
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(channels, 64, 7, 2, 3, bias=False), nn.BatchNorm2d(64)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        before = 64
        for stage, (blocks, width) in enumerate(zip(BLOCKS, WIDTHS, strict=True), start=1):
            made = []
            for block in range(blocks):
                made.append(Bottleneck(before, width, 2 if stage > 1 and block == 0 else 1))
                before = EXPANSION * width
            self.add_module(f"layer{stage}", nn.Sequential(*made))
        self.avgpool, self.fc = nn.AdaptiveAvgPool2d(1), nn.Linear(before, outputs)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, images: Tensor) -> Tensor:
        """Returns outputs (b, outputs) for images (b, channels, rows, columns)."""
        values = self.maxpool(torch.relu(self.bn1(self.conv1(images))))
        for stage in range(1, len(BLOCKS) + 1):
            values = self.get_submodule(f"layer{stage}")(values)
        outputs: Tensor = self.fc(self.avgpool(values).flatten(1))
        return outputs
