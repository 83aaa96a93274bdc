"""ResNet-50 (He et al. 2016) with torchvision's names: its weights fit, except for those of the first and last layer.

Torchvision itself is not used: its builds on PyPI are for torch with CUDA, and cannot be imported with the CPU build
that `make setup-all` installs.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

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
