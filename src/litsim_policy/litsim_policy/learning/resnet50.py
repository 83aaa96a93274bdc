"""ResNet-50 (He et al. 2016) with the names of torchvision, whose weights fit but for the first and last layer.

Torchvision itself is not asked for: its builds on pip's index are for torch with CUDA, and beside the CPU build, which
`make setup-all` installs, they cannot be imported.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

BLOCKS = (3, 4, 6, 3)  # of each of the four stages
WIDTHS = (64, 128, 256, 512)  # within their blocks
EXPANSION = 4  # channels after a block, per channel within


class Bottleneck(nn.Module):
    """Three convolutions beside a short cut; the middle one strides (version 1.5, as torchvision's)."""

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
        """(b, EXPANSION * width, rows / stride, columns / stride) of values (b, before, rows, columns)."""
        beside = values if self.downsample is None else self.downsample(values)
        inner = torch.relu(self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(values))))))
        return torch.relu(self.bn3(self.conv3(inner)) + beside)


class ResNet50(nn.Module):
    """From images (b, channels, rows, columns) to numbers (b, outputs).

    Args:
        channels: of the images; the first convolution is made for them.
        outputs: of the last layer.
    """

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

    def forward(self, images: Tensor, share: float | None = None) -> Tensor:
        """Numbers of images; where these are only a `share` of whole ones, the rest counts as 0 in the last mean."""
        values = self.maxpool(torch.relu(self.bn1(self.conv1(images))))
        for stage in range(1, len(BLOCKS) + 1):
            values = self.get_submodule(f"layer{stage}")(values)
        pooled = self.avgpool(values).flatten(1)
        found: Tensor = self.fc(pooled if share is None else pooled * share)
        return found
