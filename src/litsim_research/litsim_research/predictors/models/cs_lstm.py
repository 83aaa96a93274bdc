"""A predictor with the architecture and size of CS-LSTM, as a reference for the pipeline.

After Deo & Trivedi, "Convolutional Social Pooling for Vehicle Trajectory Prediction", 2018: an LSTM encodes each
history, the encodings of the neighbours are placed on a grid around the target (cells of 15 feet, three lanes) and
convolved, and an LSTM decoder is conditioned on the manoeuvre. There is no map. Four things differ from the paper:

- histories contain yaw and speed in addition to positions;
- the grid has 27 rows instead of 13, so that it reaches 62 m ahead and behind instead of 30 m;
- the grid contains the velocity of each neighbour relative to the target, in addition to its encoding;
- the decoder outputs deviations from constant velocity instead of positions, so that forecasts begin where the agent
  is.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import HISTORY_CHANNELS, LayerWidth
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.models.decoder import ManeuverModel
from litsim_research.predictors.models.model import (
    Decode,
    offsets,
    other_agents,
    places,
    present,
    rotate,
    rows_of,
    velocities,
)
from litsim_sim.core.quantities import configuration

UNITS = (20.0, 2.0, 0.1, 10.0)  # [m, m, rad, m/s] by which the channels of histories are scaled
RELATIVE_UNIT = 2.5  # [m/s] by which relative velocities are scaled
GRID = (27, 3)
CELL_AHEAD, CELL_LEFT = 4.572, 3.66  # [m] 15 feet, and a lane


@configuration
class CsLstmParameters:
    """Field `parameters` of a training configuration, and of a file of weights, whose model is `cs_lstm`.

    Attributes:
        encoder, decoder: numbers of units of the LSTMs.
        embedding: width of the embedding of a step of a history, and of the encoding of the target's own dynamics.
        convolution, second: channels of the two convolutions of the social pooling.
    """

    encoder: LayerWidth = 64
    decoder: LayerWidth = 128
    embedding: LayerWidth = 32
    convolution: LayerWidth = 64
    second: LayerWidth = 16


class CsLstm(ManeuverModel):
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
        self._decodes(embedding + 12 * second, parameters.decoder)

    def forward(self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None) -> Prediction:
        """See :meth:`SceneModel.forward`."""
        observed = batch.observed[..., None].to(batch.history.dtype)
        steps = torch.cat([batch.history / batch.history.new_tensor(UNITS), observed], dim=-1)
        _, (hidden, _) = self.encoder(self.embed(present(steps, batch.agent)))
        encoding = hidden[0]
        dynamics = self.dynamics(encoding if asked is None else encoding[asked])
        context = torch.cat([dynamics, self.social(social_grid(batch, encoding, asked))], dim=-1)
        return self._decoded(context, batch, decode, asked)


def social_grid(batch: SceneBatch, encoding: Tensor, asked: Tensor | None = None) -> Tensor:
    """Returns the social tensor (M, width + 2, 27, 3): features of the neighbours in the grid around each target.

    The features are the neighbours' encodings, from `encoding` (T, width) of all T agents, and their present velocities
    relative to the target, ahead and to its left; those of neighbours in the same cell are summed. The M targets are
    the agents `asked` of one scene, or all agents.
    """
    turn = -rows_of(batch.heading, asked)[..., None]
    ahead, left = rotate(rows_of(offsets(batch), asked), turn).unbind(dim=-1)
    row = torch.round(ahead / CELL_AHEAD).long() + GRID[0] // 2
    column = torch.round(left / CELL_LEFT).long() + GRID[1] // 2
    inside = (row >= 0) & (row < GRID[0]) & (column >= 0) & (column < GRID[1])
    pair = inside & other_agents(batch, asked)
    scene, target, other = torch.nonzero(pair, as_tuple=True)

    velocity = velocities(batch)
    relative = rotate(velocity[:, None] - rows_of(velocity, asked)[:, :, None], turn)[pair] / RELATIVE_UNIT
    values = torch.cat([encoding[places(batch.agent)[scene, other]], relative], dim=-1)
    targets = (encoding if asked is None else asked).shape[0]
    grid = values.new_zeros(targets * GRID[0] * GRID[1], values.shape[-1])
    cell = (row * GRID[1] + column)[pair]
    grid.index_add_(0, places(rows_of(batch.agent, asked))[scene, target] * (GRID[0] * GRID[1]) + cell, values)
    return grid.view(targets, *GRID, -1).permute(0, 3, 1, 2)
