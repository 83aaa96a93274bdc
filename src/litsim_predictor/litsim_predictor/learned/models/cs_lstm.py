"""A predictor of the size and kind of CS-LSTM, as a measure of the pipeline.

After Deo & Trivedi, "Convolutional Social Pooling for Vehicle Trajectory Prediction", 2018: an LSTM over each history,
the encodings of the neighbours laid on a 13 x 3 grid around the target (15 feet a cell) and convolved, and an LSTM
decoder conditioned on the manoeuvre. It sees no map. Two things are not theirs: histories hold yaw and speed beside
positions, and the decoder does not write positions, but how the velocity differs from constant velocity, so that
forecasts begin where the agent is.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, HISTORY_CHANNELS, HORIZON, LATERAL, LONGITUDINAL
from litsim_predictor.inference.joint_units import GAUSSIAN_CHANNELS
from litsim_predictor.learned.data.batch import Prediction, SceneBatch
from litsim_predictor.learned.models.model import (
    Decode,
    SceneModel,
    constant_velocity,
    decoded_maneuvers,
    gaussian,
    maneuver_logits,
    maneuver_parts,
    offsets,
    padded,
    present,
    rotate,
    rows_of,
    same_agent,
)

UNITS = (20.0, 2.0, 0.1, 10.0)  # of the channels of histories [m, m, rad, m/s]
GRID = (13, 3)
CELL_AHEAD, CELL_LEFT = 4.572, 3.66  # [m] 15 feet, and a lane


class CsLstm(SceneModel):
    """See the module.

    Args:
        encoder, decoder: sizes of the LSTMs.
        embedding: of the steps of histories, and of the target's own dynamics.
        convolution, second: channels of the social pooling.
    """

    def __init__(
        self, *, encoder: int = 64, decoder: int = 128, embedding: int = 32, convolution: int = 64, second: int = 16
    ) -> None:
        super().__init__()
        self.embed = nn.Sequential(nn.Linear(HISTORY_CHANNELS + 1, embedding), nn.LeakyReLU(0.1))
        self.encoder = nn.LSTM(embedding, encoder, batch_first=True)
        self.dynamics = nn.Sequential(nn.Linear(encoder, embedding), nn.LeakyReLU(0.1))
        self.social = nn.Sequential(
            nn.Conv2d(encoder, convolution, 3),
            nn.LeakyReLU(0.1),
            nn.Conv2d(convolution, second, (3, 1)),
            nn.LeakyReLU(0.1),
            nn.MaxPool2d((2, 1), padding=(1, 0)),
            nn.Flatten(),
        )
        width = embedding + 5 * second
        self.lateral, self.longitudinal = nn.Linear(width, len(LATERAL)), nn.Linear(width, len(LONGITUDINAL))
        self.decoder = nn.LSTM(width + len(LATERAL) + len(LONGITUDINAL), decoder, batch_first=True)
        self.out = nn.Linear(decoder, GAUSSIAN_CHANNELS)

    def forward(self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None) -> Prediction:
        """See :meth:`SceneModel.forward`."""
        there = batch.agent
        seen = batch.observed[..., None].to(batch.history.dtype)
        steps = torch.cat([batch.history / batch.history.new_tensor(UNITS), seen], dim=-1)
        _, (hidden, _) = self.encoder(self.embed(present(steps, there)))
        encoding = padded(hidden[0], there)
        target = rows_of(encoding, asked)
        b, n = target.shape[:2]
        social = self.social(social_grid(batch, encoding, asked)).view(b, n, -1)
        context = torch.cat([self.dynamics(target), social], dim=-1)
        logits = maneuver_logits(self.lateral(context), self.longitudinal(context))
        maneuver = decoded_maneuvers(logits, decode)
        modes = maneuver.shape[-1]
        wanted = maneuver_parts(maneuver).to(context.dtype)
        read = torch.cat([context[:, :, None].expand(-1, -1, modes, -1), wanted], dim=-1).flatten(0, 2)
        raw = self.out(self.decoder(read[:, None].expand(-1, HORIZON, -1))[0]).unflatten(0, (b, n, modes))
        scale, correlation = gaussian(raw[..., 2:])
        base = constant_velocity(rows_of(batch.state, asked))[:, :, None]
        return Prediction(logits, base + DT * raw[..., :2].cumsum(dim=-2), scale, correlation)


def social_grid(batch: SceneBatch, encoding: Tensor, asked: Tensor | None = None) -> Tensor:
    """(B * M, width, 13, 3) encodings of the agents in the cells around each agent; of two in a cell, their sum.

    The M agents are those in the rows `asked`, or all.
    """
    ahead, left = rotate(rows_of(offsets(batch), asked), -rows_of(batch.heading, asked)[..., None]).unbind(dim=-1)
    row = torch.round(ahead / CELL_AHEAD).long() + GRID[0] // 2
    column = torch.round(left / CELL_LEFT).long() + GRID[1] // 2
    inside = (row >= 0) & (row < GRID[0]) & (column >= 0) & (column < GRID[1])
    itself = same_agent(batch)
    inside = inside & ~(itself if asked is None else itself[asked]) & batch.agent[:, None]
    scene, target, neighbour = torch.nonzero(inside, as_tuple=True)
    cell = row[inside] * GRID[1] + column[inside]
    (b, n), width = inside.shape[:2], encoding.shape[-1]
    grid = encoding.new_zeros(b * n * GRID[0] * GRID[1], width)
    grid.index_add_(0, (scene * n + target) * (GRID[0] * GRID[1]) + cell, encoding[scene, neighbour])
    return grid.view(b * n, *GRID, width).permute(0, 3, 1, 2)
