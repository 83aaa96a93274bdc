"""A predictor of the size and kind of CS-LSTM, as a measure of the pipeline.

After Deo & Trivedi, "Convolutional Social Pooling for Vehicle Trajectory Prediction", 2018: an LSTM over each history,
the encodings of the neighbours laid on a grid around the target (15 feet a cell, three lanes) and convolved, and an
LSTM decoder conditioned on the manoeuvre. It sees no map. Four things are not theirs:

- histories hold yaw and speed beside positions;
- the grid has 27 rows, the paper's 13: it reaches 62 m ahead and behind instead of 30 m;
- beside the encoding of a neighbour lies its velocity relative to the target's on the grid;
- the decoder does not write positions, but how the velocity differs from constant velocity, so that forecasts begin
  where the agent is.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, HISTORY_CHANNELS, LATERAL, LONGITUDINAL
from litsim_predictor.learned.data.batch import Prediction, SceneBatch
from litsim_predictor.learned.models.decoder import ManeuverDecoder
from litsim_predictor.learned.models.model import (
    Decode,
    SceneModel,
    constant_velocity,
    decoded_maneuvers,
    gaussian,
    maneuver_logits,
    offsets,
    padded,
    places,
    present,
    rotate,
    rows_of,
    same_agent,
)
from litsim_sim.core.quantities import Positive, Whole, configuration

UNITS = (20.0, 2.0, 0.1, 10.0)  # of the channels of histories [m, m, rad, m/s]
RELATIVE_UNIT = 2.5  # [m/s] of relative velocities
GRID = (27, 3)
CELL_AHEAD, CELL_LEFT = 4.572, 3.66  # [m] 15 feet, and a lane


@configuration
class CsLstmParameters:
    """Field `parameters` of a training configuration, and of a file of weights, whose model is `cs_lstm`.

    Attributes:
        encoder, decoder: sizes of the LSTMs.
        embedding: width of the codes of a step of a history, and of the target's own dynamics.
        convolution, second: channels of the two convolutions of the social pooling.
    """

    encoder: Positive[Whole] = 64
    decoder: Positive[Whole] = 128
    embedding: Positive[Whole] = 32
    convolution: Positive[Whole] = 64
    second: Positive[Whole] = 16


class CsLstm(SceneModel):
    """See the module."""

    def __init__(self, parameters: CsLstmParameters) -> None:
        super().__init__()
        encoder, embedding = parameters.encoder, parameters.embedding
        convolution, second = parameters.convolution, parameters.second
        self.embed = nn.Sequential(nn.Linear(HISTORY_CHANNELS + 1, embedding), nn.LeakyReLU(0.1))
        self.encoder = nn.LSTM(embedding, encoder, batch_first=True)
        self.dynamics = nn.Sequential(nn.Linear(encoder, embedding), nn.LeakyReLU(0.1))
        self.social = nn.Sequential(
            nn.Conv2d(encoder + 2, convolution, 3),
            nn.LeakyReLU(0.1),
            nn.Conv2d(convolution, second, (3, 1)),
            nn.LeakyReLU(0.1),
            nn.MaxPool2d((2, 1), padding=(1, 0)),
            nn.Flatten(),
        )
        width = embedding + 12 * second
        self.lateral, self.longitudinal = nn.Linear(width, len(LATERAL)), nn.Linear(width, len(LONGITUDINAL))
        self.decoder = ManeuverDecoder(width, parameters.decoder)

    def forward(self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None) -> Prediction:
        """See :meth:`SceneModel.forward`."""
        there, answered = batch.agent, rows_of(batch.agent, asked)
        seen = batch.observed[..., None].to(batch.history.dtype)
        steps = torch.cat([batch.history / batch.history.new_tensor(UNITS), seen], dim=-1)
        _, (hidden, _) = self.encoder(self.embed(present(steps, there)))
        encoding = hidden[0]
        dynamics = self.dynamics(encoding if asked is None else encoding[asked])
        context = torch.cat([dynamics, self.social(social_grid(batch, encoding, asked))], dim=-1)
        logits = padded(maneuver_logits(self.lateral(context), self.longitudinal(context)), answered)
        raw = self.decoder(context, present(decoded_maneuvers(logits, decode), answered))
        everywhere = padded(raw, answered)
        ahead = constant_velocity(rows_of(batch.state, asked))[:, :, None] + DT * everywhere[..., :2].cumsum(dim=-2)
        scale, correlation = gaussian(everywhere[..., 2:])
        return Prediction(logits, ahead, scale, correlation)


def social_grid(batch: SceneBatch, encoding: Tensor, asked: Tensor | None = None) -> Tensor:
    """(M, width + 2, 27, 3) of what the neighbours in the cells around each target are like.

    These are their encodings, of `encoding` (T, width) of all agents in one list, and their velocities relative to the
    target's of now, ahead and to its left; of two in a cell, the sum. The M targets are the agents `asked` of one
    scene, or all.
    """
    turn = -rows_of(batch.heading, asked)[..., None]
    ahead, left = rotate(rows_of(offsets(batch), asked), turn).unbind(dim=-1)
    row = torch.round(ahead / CELL_AHEAD).long() + GRID[0] // 2
    column = torch.round(left / CELL_LEFT).long() + GRID[1] // 2
    inside = (row >= 0) & (row < GRID[0]) & (column >= 0) & (column < GRID[1])
    itself, answered = same_agent(batch), rows_of(batch.agent, asked)
    apart = ~(itself if asked is None else itself[asked])
    pair = inside & apart & answered[:, :, None] & batch.agent[:, None]
    scene, target, other = torch.nonzero(pair, as_tuple=True)

    speed, yaw = batch.state[..., 2], batch.heading + batch.state[..., 3]
    velocity = speed[..., None] * torch.stack([yaw.cos(), yaw.sin()], dim=-1)
    relative = rotate(velocity[:, None] - rows_of(velocity, asked)[:, :, None], turn)[pair] / RELATIVE_UNIT
    values = torch.cat([encoding[places(batch.agent)[scene, other]], relative], dim=-1)
    targets = (encoding if asked is None else asked).shape[0]
    grid = values.new_zeros(targets * GRID[0] * GRID[1], values.shape[-1])
    cell = (row * GRID[1] + column)[pair]
    grid.index_add_(0, places(answered)[scene, target] * (GRID[0] * GRID[1]) + cell, values)
    return grid.view(targets, *GRID, -1).permute(0, 3, 1, 2)
