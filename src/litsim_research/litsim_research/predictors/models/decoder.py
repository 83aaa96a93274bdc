"""The decoder of `bat` and `cs_lstm`: an LSTM conditioned on the manoeuvre, which outputs Gaussians."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import HORIZON, LATERAL, LONGITUDINAL
from litsim_predictor.inference.joint.units import GAUSSIAN_CHANNELS
from litsim_research.predictors.models.model import maneuver_parts


class ManeuverDecoder(nn.Module):
    """An LSTM that reads the encoding and the manoeuvre at every step.

    Both are the same at every step, so their contribution to the gates is computed once.
    """

    def __init__(self, encoding: int, units: int) -> None:
        super().__init__()
        self.encoding = nn.Linear(encoding, 4 * units)
        self.maneuver = nn.Linear(len(LATERAL) + len(LONGITUDINAL), 4 * units, bias=False)
        self.recurrent = nn.Linear(units, 4 * units, bias=False)
        self.gaussian = nn.Linear(units, GAUSSIAN_CHANNELS)

    def forward(self, encoding: Tensor, maneuver: Tensor) -> Tensor:
        """Raw outputs (T, M, HORIZON, GAUSSIAN_CHANNELS) for encodings (T, width) and manoeuvres (T, M) int64.

        The first two channels are deviations from constant velocity [m/s]; :func:`.model.gaussian` reads the others.
        """
        given = self.encoding(encoding)[:, None] + self.maneuver(maneuver_parts(maneuver).to(encoding.dtype))
        hidden = cell = given.new_zeros(*maneuver.shape, self.recurrent.in_features)
        steps = []
        for _ in range(HORIZON):
            gates = given + self.recurrent(hidden)
            let_in, keep, let_out = gates[..., : 3 * hidden.shape[-1]].sigmoid().chunk(3, dim=-1)
            cell = keep * cell + let_in * gates[..., 3 * hidden.shape[-1] :].tanh()
            hidden = let_out * cell.tanh()
            steps.append(hidden)
        raw: Tensor = self.gaussian(torch.stack(steps, dim=-2))
        return raw
