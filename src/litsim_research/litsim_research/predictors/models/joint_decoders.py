"""Decoders of the joint predictor, conditioned on the manoeuvre: all steps of the future at once, or one by one."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import HORIZON, MANEUVERS
from litsim_predictor.inference.joint.units import GAUSSIAN_CHANNELS, LENGTH
from litsim_research.predictors.models.model import future_times


class DirectDecoder(nn.Module):
    """Decodes all steps at once, as deviations from constant velocity."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.maneuver = nn.Embedding(len(MANEUVERS), width)
        self.layers = nn.Sequential(
            nn.Linear(width, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, HORIZON * GAUSSIAN_CHANNELS),
        )

    def forward(self, context: Tensor, maneuver: Tensor, base: Tensor, truth: Tensor | None) -> tuple[Tensor, Tensor]:
        """Returns means (n, HORIZON, 2) [m], and raw scales and correlation (n, HORIZON, 3).

        Args:
            context: (n, width) codes of agents.
            maneuver: (n,) int64 manoeuvres.
            base: (n, HORIZON, 2) positions at constant velocity [m].
            truth: not used.
        """
        del truth
        raw = self.layers(context + self.maneuver(maneuver)).view(-1, HORIZON, GAUSSIAN_CHANNELS)
        return base + future_times(raw)[:, None] * raw[..., :2], raw[..., 2:]


class RecurrentDecoder(nn.Module):
    """A bidirectional GRU over the steps of the future, whose forward direction alone reads positions.

    Before each step it reads the deviation from constant velocity: that of the true position with teacher forcing, or
    else that of the mean that it has decoded itself, one step after the other. The backward direction reads the code of
    the agent alone. Read backward in time, true positions would reveal the answer.
    """

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.maneuver = nn.Embedding(len(MANEUVERS), width)
        self.context = nn.Linear(width, hidden)
        self.ahead = nn.GRU(2 + hidden, hidden // 2, batch_first=True)
        self.back = nn.GRU(hidden, hidden // 2, batch_first=True)
        self.out = nn.Linear(hidden, GAUSSIAN_CHANNELS)

    def forward(self, context: Tensor, maneuver: Tensor, base: Tensor, truth: Tensor | None) -> tuple[Tensor, Tensor]:
        """See :meth:`DirectDecoder.forward`; `truth` (n, HORIZON, 2) [m] is for teacher forcing, None for none."""
        context = self.context(context + self.maneuver(maneuver)).relu()[:, None]
        steps = context.expand(-1, HORIZON, -1)
        back = self.back(steps)[0].flip(1)
        deviation, state = torch.zeros_like(base[:, :1]), None
        if truth is None:
            raw = []
            for step in range(HORIZON):
                ahead, state = self.ahead(torch.cat([deviation, context], dim=-1), state)
                raw.append(self.out(torch.cat([ahead, back[:, step : step + 1]], dim=-1)))
                deviation = raw[-1][..., :2]
            decoded = torch.cat(raw, dim=1)
        else:
            before = torch.cat([deviation, (truth - base)[:, :-1] / LENGTH], dim=1)
            ahead, _ = self.ahead(torch.cat([before, steps], dim=-1))
            decoded = self.out(torch.cat([ahead, back], dim=-1))
        return base + LENGTH * decoded[..., :2], decoded[..., 2:]
