"""What `bat` and `cs_lstm` share: manoeuvres from the encoding of an agent, and an LSTM decoder conditioned on them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, HORIZON, LATERAL, LONGITUDINAL
from litsim_predictor.inference.joint.units import GAUSSIAN_CHANNELS
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.models.model import (
    Decode,
    SceneModel,
    constant_velocity,
    decoded_maneuvers,
    gaussian,
    maneuver_logits,
    maneuver_parts,
    padded,
    present,
    rows_of,
)


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
        """Returns raw outputs (T, M, HORIZON, GAUSSIAN_CHANNELS) for encodings (T, width) and manoeuvres (T, M) int64.

        The first two channels are deviations from constant velocity [m/s]; :func:`.model.gaussian` reads the others.
        """
        constant = self.encoding(encoding)[:, None] + self.maneuver(maneuver_parts(maneuver).to(encoding.dtype))
        hidden = cell = constant.new_zeros(*maneuver.shape, self.recurrent.in_features)
        steps = []
        for _ in range(HORIZON):
            gates = constant + self.recurrent(hidden)
            let_in, keep, let_out = gates[..., : 3 * hidden.shape[-1]].sigmoid().chunk(3, dim=-1)
            cell = keep * cell + let_in * gates[..., 3 * hidden.shape[-1] :].tanh()
            hidden = let_out * cell.tanh()
            steps.append(hidden)
        raw: Tensor = self.gaussian(torch.stack(steps, dim=-2))
        return raw


class ManeuverModel(SceneModel):
    """A model that decodes manoeuvres, each as deviations from constant velocity, from an encoding of every agent."""

    def _decodes(self, encoding: int, units: int) -> None:
        """Makes the layers behind an encoding of width `encoding`; the LSTM has `units`."""
        self.lateral, self.longitudinal = nn.Linear(encoding, len(LATERAL)), nn.Linear(encoding, len(LONGITUDINAL))
        self.decoder = ManeuverDecoder(encoding, units)

    def _decoded(self, encoding: Tensor, batch: SceneBatch, decode: Decode, asked: Tensor | None) -> Prediction:
        """Returns the prediction from encodings (T, width) of the agents predicted; see :meth:`SceneModel.forward`."""
        answered = rows_of(batch.agent, asked)
        logits = padded(maneuver_logits(self.lateral(encoding), self.longitudinal(encoding)), answered)
        raw = padded(self.decoder(encoding, present(decoded_maneuvers(logits, decode), answered)), answered)
        mean = constant_velocity(rows_of(batch.state, asked))[:, :, None] + DT * raw[..., :2].cumsum(dim=-2)
        return Prediction(logits, mean, *gaussian(raw[..., 2:]))
