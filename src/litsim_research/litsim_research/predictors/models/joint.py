"""The joint predictor of the LitSim paper (section III-A), with alternatives to three of its parts.

A small CNN encodes the map raster, a bidirectional GRU the history, and an MLP with eight-head attention between the
agents the current states (the paper's dynamic encoder). Manoeuvres are predicted from these codes, and a decoder
conditioned on them outputs Gaussians, for all agents of a scene in one pass.

Three parts are chosen by configuration (:class:`.JointParameters`): how histories are read (`history`), what agents
attend to (`attention`) and how futures are decoded (`decoder`).
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import HORIZON, MANEUVERS, STATE_CHANNELS
from litsim_predictor.inference.joint.parameters import JointParameters
from litsim_predictor.inference.joint.units import STATE_UNITS, TRAFFIC_CHANNELS, TRAFFIC_PLACES, TRAFFIC_UNITS
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.models.joint_attention import Neighbours, PairAttention, RelativeAttention
from litsim_research.predictors.models.joint_decoders import DirectDecoder, RecurrentDecoder
from litsim_research.predictors.models.joint_encoders import DirectHistory, MapEncoder, RecurrentHistory
from litsim_research.predictors.models.model import (
    Decode,
    SceneModel,
    constant_velocity,
    decoded_maneuvers,
    gaussian,
    linear_of,
    padded,
    present,
    rows_of,
)

DECODERS = {"direct": DirectDecoder, "recurrent": RecurrentDecoder}


class JointPredictor(SceneModel):
    """Encoders of map, history and state, attention between the agents, and a decoder; see the module."""

    def __init__(self, parameters: JointParameters) -> None:
        super().__init__()
        width, hidden, heads = parameters.width, parameters.hidden, parameters.heads
        self.map = MapEncoder(parameters.map_channels, parameters.map_width)
        self.history = (
            DirectHistory(parameters.history_width)
            if parameters.history == "direct"
            else RecurrentHistory(parameters.history_width, parameters.history_channels)
        )
        self.scene: nn.Module | None = None
        if parameters.attention == "states":
            self.scene = PairAttention(parameters.state_width, heads, parameters.neighbours, parameters.reach)
        else:
            read = STATE_CHANNELS + TRAFFIC_CHANNELS * parameters.traffic
            self.state = nn.Sequential(nn.Linear(read, parameters.state_width), nn.ReLU())
        self.traffic, self.neighbours, self.reach = parameters.traffic, parameters.neighbours, parameters.reach
        layers = parameters.layers if parameters.attention == "codes" else 0
        self.relative = nn.ModuleList([RelativeAttention(width, heads) for _ in range(layers)])
        self.dropout = nn.Dropout(parameters.dropout)
        self.maneuver = nn.Sequential(nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, len(MANEUVERS)))
        self.decoder = DECODERS[parameters.decoder](width, hidden)

    def forward(
        self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None, maps: Tensor | None = None
    ) -> Prediction:
        """See :meth:`SceneModel.forward`; `batch` may be one scene without the dimension B and without padding.

        `maps` (T, map_width) are the codes by :attr:`map` of the rasters of the T agents that are not padding; if they
        are given, the rasters are not read.
        """
        is_agent = batch.agent
        maps = self.map(present(batch.raster, is_agent)) if maps is None else maps
        histories = self.history(present(batch.history, is_agent), present(batch.observed, is_agent))
        if self.scene is None:
            read = torch.cat([batch.state, batch.traffic], dim=-1) if self.traffic else batch.state
            units = read.new_tensor(STATE_UNITS + TRAFFIC_UNITS * (TRAFFIC_PLACES * self.traffic))
            states = self.state[1](linear_of(present(read, is_agent), units, cast(nn.Linear, self.state[0])))
        else:
            states = present(self.scene(batch), is_agent)
        agents = padded(torch.cat([maps, histories, states], dim=-1), is_agent)
        if len(self.relative):
            near = Neighbours.of(batch, self.neighbours, self.reach)
            for layer in self.relative[:-1]:
                agents = layer(agents, near)
            agents = self.relative[-1](agents, near.seen_by(asked), asked)
        else:
            agents = rows_of(agents, asked, is_agent.dim() - 1)
        logits = self.maneuver(agents)
        return self._decode(batch, asked, self.dropout(agents), logits, decode)

    def _decode(
        self, batch: SceneBatch, asked: Tensor | None, agents: Tensor, logits: Tensor, decode: Decode
    ) -> Prediction:
        maneuver = decoded_maneuvers(logits, decode)
        modes = 1 if decode == "best" else maneuver.shape[-1]

        def for_each_maneuver(values: Tensor) -> Tensor:
            """Returns `values` (..., N, ...) of agents, repeated for each of their M manoeuvres: (B * N * M, ...)."""
            by_agent = values if batch.agent.dim() == 1 else values.flatten(0, 1)
            return by_agent if modes == 1 else by_agent.repeat_interleave(modes, dim=0)

        base, truth = constant_velocity(rows_of(batch.state, asked, batch.agent.dim() - 1)), None
        if self.training and float(torch.rand(())) < self.forcing:
            truth = for_each_maneuver(torch.where(batch.future_known[..., None], batch.future, base))
        mean, raw = self.decoder(for_each_maneuver(agents), maneuver.reshape(-1), for_each_maneuver(base), truth)
        scale, correlation = gaussian(raw)
        shape = (*logits.shape[:-2], -1, modes, HORIZON)
        return Prediction(logits, mean.view(*shape, 2), scale.view(*shape, 2), correlation.view(*shape))
