"""The joint predictor of the LitSim paper (section III-A), with alternatives to three of its parts.

A small CNN encodes the map raster, a bidirectional GRU the history, and an MLP with eight-head attention between the
agents the current states (the paper's dynamic encoder). Manoeuvres are predicted from these codes, and a decoder
conditioned on them outputs Gaussians, for all agents of a scene in one pass.

Three parts are chosen by configuration (:class:`.JointParameters`), because the paper's choices measure worse: how
histories are read (`history`), how agents attend to each other (`relative`) and how futures are decoded (`decoder`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, HISTORY, HISTORY_CHANNELS, HORIZON, MANEUVERS, STATE_CHANNELS
from litsim_predictor.inference.joint_parameters import JointParameters
from litsim_predictor.inference.joint_units import (
    DEVIATION_UNITS,
    GAUSSIAN_CHANNELS,
    HISTORY_UNITS,
    LANE,
    LENGTH,
    MAP_MIDDLE,
    NEAR,
    RELATION_CHANNELS,
    RELATION_UNITS,
    RELATION_WIDTH,
    STATE_UNITS,
    TRAFFIC_CHANNELS,
    TRAFFIC_PLACES,
    TRAFFIC_UNITS,
)
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS
from litsim_predictor.learned.data.batch import Prediction, SceneBatch
from litsim_predictor.learned.models.model import (
    Decode,
    SceneModel,
    chosen,
    constant_velocity,
    decoded_maneuvers,
    future_times,
    gaussian,
    linear_of,
    padded,
    present,
    rows_of,
    same_agent,
)


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
        """Codes (n, width) of rasters (n, CHANNELS, ROWS, COLUMNS) uint8."""
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
        """Codes (n, width) of `history` (n, HISTORY, HISTORY_CHANNELS), with the mask `observed` (n, HISTORY)."""
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
        seen, now = observed.to(history.dtype), speed[:, -1:]
        ago = DT * torch.arange(HISTORY - 1, -1, -1, dtype=history.dtype, device=history.device)
        read = torch.stack([(x + ago * now) * seen, y, yaw, (speed - now) * seen, seen], dim=-1)
        units = history.new_tensor([*DEVIATION_UNITS, 1.0]).repeat(HISTORY)
        return cast(Tensor, self.layers[1:](linear_of(read.flatten(1), units, cast(nn.Linear, self.layers[0]))))


class RelativeAttention(nn.Module):
    """Attention to the nearest agents, with keys and values that also depend on their relative pose and motion.

    Every agent attends to itself as well, so that attention is defined for an agent on its own.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.width, self.heads = width, heads
        self.query, self.key_value = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.relation = nn.Sequential(
            nn.Linear(RELATION_CHANNELS, RELATION_WIDTH), nn.ReLU(), nn.Linear(RELATION_WIDTH, 2 * width)
        )
        self.out = nn.Linear(width, width)
        self.norm = nn.LayerNorm(width)

    def forward(self, agents: Tensor, near: Neighbours, asked: Tensor | None = None) -> Tensor:
        """Codes (..., N, width): `agents` plus attention to those `near` each of them, with layer normalisation.

        With `asked` (M,), only the codes (..., M, width) of these rows; `near` must then be that of these rows.
        """
        size = self.width // self.heads

        def by_head(values: Tensor) -> Tensor:
            """`values` (..., N, width) by head: (..., heads, N, size)."""
            return values.view(*values.shape[:-2], -1, self.heads, size).transpose(-2, -3)

        # The contribution of a relation to keys and values is linear in `related`. It is factored out of the sums over
        # neighbours, so that its large matrix is applied once per agent instead of once per pair.
        first, last = cast(nn.Linear, self.relation[0]), cast(nn.Linear, self.relation[-1])
        related = linear_of(near.relation, agents.new_tensor(RELATION_UNITS), first).relu()  # (..., M, K, 64)
        of_key, of_value = last.weight.view(2, self.heads, size, -1).unbind()
        asking, scale = rows_of(agents, asked, agents.dim() - 2), size**-0.5
        query = by_head(nn.functional.linear(asking, self.query.weight * scale, self.query.bias * scale))
        bias = self.key_value.bias + last.bias
        key, value = (
            by_head(nn.functional.linear(agents, self.key_value.weight[part], bias[part]))
            for part in (slice(self.width), slice(self.width, None))
        )

        # Products of all agents with all agents are cheaper than gathering keys and values for each pair.
        index = near.index.unsqueeze(-3)
        index = index.expand(*index.shape[:-3], self.heads, -1, -1)
        wanted = (query @ of_key).transpose(-2, -3)  # (..., M, heads, 64)
        everybody = query @ key.transpose(-1, -2)
        logits = everybody.gather(-1, index) + (wanted @ related.transpose(-1, -2)).transpose(-2, -3)
        weights = logits.masked_fill(~near.seen.unsqueeze(-3), float("-inf")).softmax(dim=-1)  # (..., heads, M, K)
        told = (weights.transpose(-2, -3) @ related).transpose(-2, -3) @ of_value.transpose(-1, -2)
        heard = torch.zeros_like(everybody).scatter(-1, index, weights) @ value + told
        heard = heard.transpose(-2, -3).reshape(*asking.shape[:-2], -1, self.width)
        return cast(Tensor, self.norm(asking + self.out(heard)))


class SceneAttention(nn.Module):
    """The paper's dynamic encoder: attention over current states in a frame common to the scene."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.embed = nn.Sequential(nn.Linear(STATE_CHANNELS + 4, width), nn.ReLU())
        self.attention = nn.MultiheadAttention(width, heads, batch_first=True)

    def forward(self, batch: SceneBatch) -> Tensor:
        """Codes (..., N, width) of all agents of `batch`, each by attention over all agents of its scene."""
        there = batch.agent[..., None].to(batch.position.dtype)
        middle = (batch.position * there).sum(dim=-2, keepdim=True) / there.sum(dim=-2, keepdim=True)
        yaw = batch.heading + batch.state[..., 3]
        place = torch.cat([(batch.position - middle) / LENGTH, torch.stack([yaw.cos(), yaw.sin()], dim=-1)], dim=-1)
        read = torch.cat([batch.state, place], dim=-1)
        units = read.new_tensor([*STATE_UNITS, 1.0, 1.0, 1.0, 1.0])
        states = self.embed[1](linear_of(read, units, cast(nn.Linear, self.embed[0])))
        # Computed as by nn.MultiheadAttention, a trace of which would be valid for its number of agents only.
        attention = self.attention
        lead, size = states.shape[:-2], attention.embed_dim // attention.num_heads
        mixed = nn.functional.linear(states, attention.in_proj_weight, attention.in_proj_bias)
        query, key, value = (
            part.view(*lead, -1, attention.num_heads, size).transpose(-2, -3)
            for part in mixed.split(attention.embed_dim, dim=-1)
        )
        logits = query @ key.transpose(-1, -2) * size**-0.5
        weights = logits.masked_fill(~batch.agent[..., None, None, :], float("-inf")).softmax(dim=-1)
        heard = (weights @ value).transpose(-2, -3).reshape(*lead, -1, attention.embed_dim)
        return cast(Tensor, attention.out_proj(heard))


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
        """Means (n, HORIZON, 2) [m], and raw scales and correlation (n, HORIZON, 3).

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
    """A bidirectional GRU over the steps of the future, which reads the position before each step.

    With teacher forcing in training, these are the true positions. Otherwise there are two passes, since a
    bidirectional network cannot be unrolled step by step: the first reads positions at constant velocity, the second
    the means of the first. Read backward in time, true positions reveal the answer, so that teacher forcing has to fade
    in the course of training.
    """

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.maneuver = nn.Embedding(len(MANEUVERS), width)
        self.context = nn.Linear(width, hidden)
        self.gru = nn.GRU(2 + hidden, hidden // 2, batch_first=True, bidirectional=True)
        self.out = nn.Linear(hidden, GAUSSIAN_CHANNELS)

    def forward(self, context: Tensor, maneuver: Tensor, base: Tensor, truth: Tensor | None) -> tuple[Tensor, Tensor]:
        """See :meth:`DirectDecoder.forward`; `truth` (n, HORIZON, 2) [m] is for teacher forcing, None for none."""
        context = self.context(context + self.maneuver(maneuver)).relu()
        if truth is not None:
            return self._read(context, truth, base)
        first, _ = self._read(context, base, base)
        return self._read(context, first, base)

    def _read(self, context: Tensor, positions: Tensor, base: Tensor) -> tuple[Tensor, Tensor]:
        before = torch.cat([torch.zeros_like(positions[:, :1]), positions[:, :-1]], dim=1)
        steps = context[:, None].expand(-1, HORIZON, -1)
        raw = self.out(self.gru(torch.cat([(before - base) / LENGTH, steps], dim=-1))[0])
        return base + LENGTH * raw[..., :2], raw[..., 2:]


class JointPredictor(SceneModel):
    """See the module."""

    def __init__(self, parameters: JointParameters) -> None:
        super().__init__()
        of = parameters
        self.map = MapEncoder(of.map_channels, of.map_width)
        self.history = (
            DirectHistory(of.history_width)
            if of.history == "direct"
            else RecurrentHistory(of.history_width, of.history_channels)
        )
        self.scene = None if of.relative else SceneAttention(of.state_width, of.heads)
        if self.scene is None:
            read = STATE_CHANNELS + TRAFFIC_CHANNELS * of.traffic
            self.state = nn.Sequential(nn.Linear(read, of.state_width), nn.ReLU())
        self.traffic, self.neighbours, self.reach = of.traffic, of.neighbours, of.reach
        self.relative = nn.ModuleList(
            [RelativeAttention(of.width, of.heads) for _ in range(of.layers if of.relative else 0)]
        )
        self.dropout = nn.Dropout(of.dropout)
        self.maneuver = nn.Sequential(nn.Linear(of.width, of.hidden), nn.ReLU(), nn.Linear(of.hidden, len(MANEUVERS)))
        self.decoder = (DirectDecoder if of.decoder == "direct" else RecurrentDecoder)(of.width, of.hidden)

    def forward(
        self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None, maps: Tensor | None = None
    ) -> Prediction:
        """See :meth:`SceneModel.forward`; `batch` may be one scene without the dimension B and without padding.

        `maps` (T, map_width) are the codes by :attr:`map` of the rasters of the T agents that are not padding; if they
        are given, the rasters are not read.
        """
        there = batch.agent
        maps = self.map(present(batch.raster, there)) if maps is None else maps
        histories = self.history(present(batch.history, there), present(batch.observed, there))
        if self.scene is None:
            read = torch.cat([batch.state, batch.traffic], dim=-1) if self.traffic else batch.state
            units = read.new_tensor(STATE_UNITS + TRAFFIC_UNITS * (TRAFFIC_PLACES * self.traffic))
            states = self.state[1](linear_of(present(read, there), units, cast(nn.Linear, self.state[0])))
        else:
            states = present(self.scene(batch), there)
        agents = padded(torch.cat([maps, histories, states], dim=-1), there)
        if len(self.relative):
            near = Neighbours.of(batch, self.neighbours, self.reach)
            for layer in self.relative[:-1]:
                agents = layer(agents, near)
            agents = self.relative[-1](agents, near.seen_by(asked), asked)
        else:
            agents = rows_of(agents, asked, there.dim() - 1)
        logits = self.maneuver(agents)
        return self._decode(batch, asked, self.dropout(agents), logits, decode)

    def _decode(
        self, batch: SceneBatch, asked: Tensor | None, agents: Tensor, logits: Tensor, decode: Decode
    ) -> Prediction:
        maneuver = decoded_maneuvers(logits, decode)
        modes = 1 if decode == "best" else maneuver.shape[-1]

        def for_each_maneuver(values: Tensor) -> Tensor:
            """The `values` (..., N, ...) of the agents, repeated for each of their M manoeuvres: (B * N * M, ...)."""
            everybody = values if batch.agent.dim() == 1 else values.flatten(0, 1)
            return everybody if modes == 1 else everybody.repeat_interleave(modes, dim=0)

        base, truth = constant_velocity(rows_of(batch.state, asked, batch.agent.dim() - 1)), None
        if self.training and float(torch.rand(())) < self.forcing:
            truth = for_each_maneuver(torch.where(batch.future_known[..., None], batch.future, base))
        mean, raw = self.decoder(for_each_maneuver(agents), maneuver.reshape(-1), for_each_maneuver(base), truth)
        scale, correlation = gaussian(raw)
        shape = (*logits.shape[:-2], -1, modes, HORIZON)
        return Prediction(logits, mean.view(*shape, 2), scale.view(*shape, 2), correlation.view(*shape))


@dataclass(frozen=True)
class Neighbours:
    """The K agents nearest to each of N agents, itself among them.

    Attributes:
        index: (..., N, K) int64 indices of these agents.
        seen: (..., N, K) bool, whether they are within reach and not padding; every agent sees itself, padding as well,
            so that attention is always finite.
        relation: (..., N, K, RELATION_CHANNELS) their poses and motions relative to the agent; channels, and the units
            by which they are yet to be scaled, as in :data:`RELATION_UNITS`.
    """

    index: Tensor
    seen: Tensor
    relation: Tensor

    @classmethod
    def of(cls, batch: SceneBatch, count: int, reach: float) -> Neighbours:
        """For each agent of `batch` itself and at most `count` others that are nearer than `reach` [m]."""
        x, y = batch.position.unbind(dim=-1)
        squared = (x[..., None, :] - x[..., None]).square() + (y[..., None, :] - y[..., None]).square()
        if batch.agent.dim() > 1:
            squared = squared.masked_fill(~batch.agent[..., None, :], float("inf"))
        squared = squared.masked_fill(same_agent(batch), -1.0)
        # The number of agents is a tensor, which a trace does not take for a constant.
        most = torch.as_tensor(squared.shape[-1]).clamp_max(count + 1)
        squared, index = squared.topk(cast(int, most), dim=-1, largest=False, sorted=False)
        # x, y, heading and speed of each agent, and of each of those near it
        pose = torch.cat([batch.position, batch.heading[..., None], batch.state[..., 2:3]], dim=-1)
        other, own = chosen(pose, index), pose[..., None, :]
        dx, dy, turn, faster = (other - own).split(1, dim=-1)
        heading = own[..., 2:3]
        cos, sin = heading.cos(), heading.sin()
        ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
        in_lane = (left.abs() < 0.5 * LANE).to(ahead.dtype)
        near = 1.0 / (ahead.abs() + NEAR)
        relation = [ahead, left, near, turn.cos(), turn.sin(), faster, other[..., 3:], in_lane * ahead.sign()]
        return cls(index, squared < reach**2, torch.cat(relation, dim=-1))

    def seen_by(self, agents: Tensor | None) -> Neighbours:
        """The neighbours of the rows `agents` (M,) only; of all rows for None."""
        dim = self.index.dim() - 2
        return Neighbours(*(rows_of(v, agents, dim) for v in (self.index, self.seen, self.relation)))
