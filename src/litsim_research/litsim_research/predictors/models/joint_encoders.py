"""Encoders of the joint predictor: of the map raster around each agent, and of each agent's history."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, HISTORY, HISTORY_CHANNELS
from litsim_predictor.inference.joint.units import DEVIATION_UNITS, HISTORY_UNITS, MAP_MIDDLE
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS
from litsim_research.predictors.models.model import linear_of


class MapEncoder(nn.Module):
    """Two 3 x 3 convolutions, max-pooling, another 3 x 3 convolution, and an MLP (paper, section IV-A)."""

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        self.width = width
        self.layers = nn.Sequential(
            nn.Conv2d(CHANNELS, channels, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(channels * (ROWS // 4) * (COLUMNS // 4), width),
            nn.ReLU(),
        )

    def forward(self, raster: Tensor) -> Tensor:
        """Returns codes (n, width) of rasters (n, CHANNELS, ROWS, COLUMNS) uint8."""
        # Bytes are scaled to -1 to 1; the weights are divided instead of the values, since they are fewer.
        first = cast(nn.Conv2d, self.layers[0])
        read = nn.functional.conv2d(raster.float() - MAP_MIDDLE, first.weight / MAP_MIDDLE, first.bias, first.stride, 1)
        return cast(Tensor, self.layers[1:](read))


class RecurrentHistory(nn.Module):
    """A bidirectional GRU over the steps of the history; the code is the last states of both directions."""

    def __init__(self, width: int, channels: int) -> None:
        super().__init__()
        self.channels = channels
        self.embed = nn.Sequential(nn.Linear(channels + 1, width // 2), nn.ReLU())
        self.gru = nn.GRU(width // 2, width // 2, bidirectional=True)

    def forward(self, history: Tensor, observed: Tensor) -> Tensor:
        """Returns codes (n, width) of `history` (n, HISTORY, HISTORY_CHANNELS), with mask `observed` (n, HISTORY)."""
        read = torch.cat([history[..., : self.channels], observed[..., None].to(history.dtype)], dim=-1)
        units = history.new_tensor([*HISTORY_UNITS[: self.channels], 1.0])
        _, last = self.gru(self.embed[1](linear_of(read.transpose(0, 1), units, cast(nn.Linear, self.embed[0]))))
        return torch.cat([last[0], last[1]], dim=-1)


class DirectHistory(nn.Module):
    """Two dense layers that read all steps of the history at once, as deviations from constant speed straight ahead."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(HISTORY * (HISTORY_CHANNELS + 1), 2 * width), nn.ReLU(), nn.Linear(2 * width, width), nn.ReLU()
        )

    def forward(self, history: Tensor, observed: Tensor) -> Tensor:
        """See :meth:`RecurrentHistory.forward`."""
        x, y, yaw, speed = history.unbind(dim=-1)
        mask, now = observed.to(history.dtype), speed[:, -1:]
        ago = DT * torch.arange(HISTORY - 1, -1, -1, dtype=history.dtype, device=history.device)
        read = torch.stack([(x + ago * now) * mask, y, yaw, (speed - now) * mask, mask], dim=-1)
        units = history.new_tensor([*DEVIATION_UNITS, 1.0]).repeat(HISTORY)
        return cast(Tensor, self.layers[1:](linear_of(read.flatten(1), units, cast(nn.Linear, self.layers[0]))))
