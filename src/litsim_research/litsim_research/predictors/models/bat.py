"""BAT, the behaviour-aware predictor of Liao et al. (AAAI 2024), implemented from the paper's description.

Every agent of a scene is a target once. Interactions are encoded in polar coordinates around the target's present
position, and behaviours by centralities in the proximity graph of the agents. Predicted means are Cartesian, in the
agent frames. Where the paper leaves a choice open, or we differ from it:

- angles are given by sine and cosine, since a target's own past is at an angle of pi, where a plain angle would jump;
- there is one graph for the whole scene, so that centralities are computed once per scene instead of once per target;
- motions contain the velocity relative to the target's present one, and thus yaw and speed, beside the radial velocity;
- the grid reaches 62 m ahead and behind instead of 30 m, so that it includes vehicles beyond the leader;
- the decoder outputs deviations from constant velocity, so that forecasts begin where the agent is;
- neighbours are a list of pairs instead of a grid that is mostly empty; see :func:`neighbours`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self, cast

import torch
from pydantic import model_validator
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, STATE_CHANNELS, LayerWidth
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.models.centrality import CENTRALITIES, centralities, mean_rates, proximity_graph
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
from litsim_sim.core.quantities import Length, Positive, configuration

GRID_ROWS, GRID_COLUMNS = 27, 3
CELL_LENGTH, CELL_WIDTH = 4.57, 3.66  # [m]: 15 feet, as is usual on NGSIM, and a lane
POLAR_CHANNELS = 7  # r, cos phi, sin phi, radial velocity, relative velocity ahead and to the left, observed
LENGTH_UNIT, SPEED_UNIT = 10.0, 10.0  # [m], [m/s] by which inputs are scaled
RELATIVE_UNIT = 2.5  # [m/s] by which relative velocities are scaled
AT_ORIGIN = 1e-3  # [m] distance up to which a position has no angle
NEVER = -1e9  # masked logit of the attention; finite, since all logits of a target may be masked
APPROACH_S = 3.0  # [s] for which constant velocities are assumed when neighbours are ranked


@dataclass(frozen=True)
class Motions:
    """Motions of T agents, of all scenes, over the history; in the axes of frame map.

    Attributes:
        position: (T, 2) present positions [m].
        heading: (T,) headings of the agent frames [rad].
        path: (T, HISTORY, 2) positions [m].
        velocity: (T, HISTORY, 2) velocities [m/s].
        observed: (T, HISTORY) bool.
    """

    position: Tensor
    heading: Tensor
    path: Tensor
    velocity: Tensor
    observed: Tensor


@dataclass(frozen=True)
class Neighbours:
    """P pairs of a target and one of its neighbours.

    Attributes:
        target: (P,) indices in the list of targets.
        other: (P,) indices in the list of agents.
        cell: (P,) cells of the target's grid that contain the neighbours, numbered row by row.
        rank: (P,) ranks among the target's neighbours, 0 for the most important.
    """

    target: Tensor
    other: Tensor
    cell: Tensor
    rank: Tensor

    def and_nobody(self) -> Neighbours:
        """Returns these pairs and a dummy at the end, which fills unused slots; a graph cannot be run on no pairs."""
        return Neighbours(*(torch.cat([v, v.new_zeros(1)]) for v in (self.target, self.other, self.cell, self.rank)))


@configuration
class BatParameters:
    """Field `parameters` of a training configuration, and of a file of weights, whose model is `bat`.

    Attributes:
        radius: distance within which agents are joined by an edge of the graph.
        embedding: width of embeddings and of the encodings of agents; even, and a multiple of `heads`.
        motion_units: number of units of the LSTMs that read motions.
        behaviour_units: number of units of the LSTMs that read centralities.
        decoder_units: number of units of the LSTM of the decoder.
        heads: number of heads of the attention.
    """

    radius: Positive[Length] = 10.0
    embedding: LayerWidth = 32
    motion_units: LayerWidth = 64
    behaviour_units: LayerWidth = 8
    decoder_units: LayerWidth = 128
    heads: LayerWidth = 4

    @model_validator(mode="after")
    def _fit(self) -> Self:
        if self.embedding % self.heads or self.embedding % 2:
            raise ValueError(f"embedding is {self.embedding}, expected an even multiple of heads, {self.heads}")
        return self


class Bat(ManeuverModel):
    """About 0.3 million weights; see the module."""

    def __init__(self, parameters: BatParameters) -> None:
        super().__init__()
        embedding = parameters.embedding
        self.behaviour = BehaviourEncoder(parameters.radius, embedding, parameters.behaviour_units)
        behaviour = self.behaviour.size
        self.target = MotionEncoder(embedding, parameters.motion_units, behaviour + STATE_CHANNELS)
        self.other = MotionEncoder(embedding, parameters.motion_units, behaviour)
        self.interaction = InteractionEncoder(embedding, parameters.heads)
        self._decodes(embedding + self.interaction.size, parameters.decoder_units)

    def forward(self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None) -> Prediction:
        """See :meth:`SceneModel.forward`."""
        motions = motions_of(batch)
        behaviour = present(self.behaviour(batch), batch.agent)
        targets = torch.arange(len(behaviour), device=behaviour.device) if asked is None else asked
        features = torch.cat([behaviour[targets], present(batch.state, batch.agent)[targets] / SPEED_UNIT], dim=-1)
        target = self.target(polar(motions, targets, targets), features)
        pairs = neighbours(batch, asked).and_nobody()
        motion = polar(motions, targets[pairs.target], pairs.other)
        other = self.other(motion, behaviour[pairs.other])
        encoding = torch.cat([target, self.interaction(target, other, motion, pairs)], dim=-1)
        return self._decoded(encoding, batch, decode, asked)


class BehaviourEncoder(nn.Module):
    """Encodes the behaviour of each agent, from its centralities over the history and their mean rates of change."""

    def __init__(self, radius: float, embedding: int, units: int) -> None:
        super().__init__()
        self.radius = radius
        self.series = nn.ModuleList(SeriesEncoder(len(CENTRALITIES), embedding, units) for _ in range(2))
        self.size = 2 * units

    def forward(self, batch: SceneBatch) -> Tensor:
        """Returns encodings (B, N, size) of the behaviour of all agents of `batch`."""
        path = rotate(batch.history[..., :2], batch.heading[..., None]) + batch.position[..., None, :]
        observed = batch.observed & batch.agent[..., None]
        length = proximity_graph(path.transpose(1, 2), observed.transpose(1, 2), self.radius)
        series = centralities(length).transpose(1, 2) * observed[..., None]  # (B, N, HISTORY, 6)
        both = (series, mean_rates(series, observed, DT))
        codes = [encoder(values.flatten(0, 1)) for encoder, values in zip(self.series, both, strict=True)]
        return torch.cat(codes, dim=-1).view(*batch.agent.shape, -1)


class SeriesEncoder(nn.Module):
    """A linear layer, an LSTM and a linear layer over series (S, HISTORY, channels)."""

    def __init__(self, channels: int, embedding: int, units: int) -> None:
        super().__init__()
        self.embed = nn.Linear(channels, embedding)
        self.lstm = nn.LSTM(embedding, units, batch_first=True)
        self.code = nn.Linear(units, units)

    def forward(self, series: Tensor) -> Tensor:
        """Returns encodings (S, units) of `series` (S, HISTORY, channels)."""
        code: Tensor = self.code(last_state(self.lstm, nn.functional.elu(self.embed(series))))
        return code


class MotionEncoder(nn.Module):
    """Encodes an agent's motion relative to a target, and further features of the agent."""

    def __init__(self, embedding: int, units: int, features: int) -> None:
        super().__init__()
        self.embed = nn.Linear(POLAR_CHANNELS, embedding)
        self.lstm = nn.LSTM(embedding, units, batch_first=True)
        self.code = nn.Linear(units + features, embedding)

    def forward(self, motion: Tensor, features: Tensor) -> Tensor:
        """Returns encodings (S, embedding) of `motion` (S, steps, POLAR_CHANNELS) and `known` features (S, k)."""
        state = last_state(self.lstm, nn.functional.elu(self.embed(motion)))
        return nn.functional.elu(self.code(torch.cat([state, features], dim=-1)))


class InteractionEncoder(nn.Module):
    """Encodes the neighbours of each target: attention over them and their cells, and a max-pooled contribution."""

    def __init__(self, embedding: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.cell = nn.Embedding(GRID_ROWS * GRID_COLUMNS, embedding)
        inputs = embedding + POLAR_CHANNELS - 1  # without `observed`: neighbours are observed now
        self.contribution = nn.Sequential(nn.Linear(inputs, 128), nn.ReLU(), nn.Linear(128, 256), nn.ReLU())
        self.query = nn.Linear(embedding, embedding)
        self.key_value = nn.Linear(embedding, 2 * embedding)
        self.size = embedding + 256

    def forward(self, target: Tensor, other: Tensor, motion: Tensor, pairs: Neighbours) -> Tensor:
        """Returns encodings (T, size) of the neighbours of T targets; zeros for targets without neighbours.

        Args:
            target: (T, embedding) encodings of the targets.
            other: (P, embedding) encodings of the neighbours in `pairs`.
            motion: (P, HISTORY, POLAR_CHANNELS) motions of the neighbours relative to their targets.
            pairs: the pairs, the last one a dummy; see :meth:`Neighbours.and_nobody`.
        """
        other = other + rank_encoding(pairs.rank, other.shape[-1])
        now = motion[:, -1, :-1]
        contribution = self.contribution(torch.cat([other, now], dim=-1))  # not negative
        slots, used = slots_of(pairs.target[:-1], target.shape[0])
        pooled = (contribution[slots] * used[..., None]).amax(dim=1)
        return torch.cat([self._attend(target, other + self.cell(pairs.cell), slots, used), pooled], dim=-1)

    def _attend(self, target: Tensor, other: Tensor, slots: Tensor, used: Tensor) -> Tensor:
        """Returns attention (T, embedding) of each target to its neighbours; `slots`, `used`: see :func:`slots_of`."""
        query = self.query(target).view(target.shape[0], 1, self.heads, -1)
        key, value = self.key_value(other)[slots].view(*slots.shape, 2, self.heads, -1).unbind(dim=2)
        score = (query * key).sum(dim=-1) * (other.shape[-1] / self.heads) ** -0.5  # (T, R, heads)
        share = score.masked_fill(~used[..., None], NEVER).softmax(dim=1) * used[..., None]
        return (share[..., None] * value).sum(dim=1).flatten(1)


def motions_of(batch: SceneBatch) -> Motions:
    """Returns the motions of the agents of all scenes, in one list without padding."""
    is_agent = batch.agent
    history, position, heading = (present(v, is_agent) for v in (batch.history, batch.position, batch.heading))
    direction = torch.stack([history[..., 2].cos(), history[..., 2].sin()], dim=-1)
    return Motions(
        position=position,
        heading=heading,
        path=rotate(history[..., :2], heading[:, None]) + position[:, None],
        velocity=rotate(history[..., 3, None] * direction, heading[:, None]),
        observed=present(batch.observed, is_agent),
    )


def polar(motions: Motions, target: Tensor, other: Tensor) -> Tensor:
    """Returns motions (P, HISTORY, POLAR_CHANNELS) of `other` relative to `target`, both (P,) indices in `motions`.

    The polar coordinates r and phi are in the target's present frame, phi as cosine and sine. The radial velocity is
    positive where r grows; at the origin it is minus the speed, as for an agent that arrives there. The relative
    velocity is that of `other` minus the target's present one, ahead of and to the left of the target. The units are
    :data:`LENGTH_UNIT`, :data:`SPEED_UNIT` and :data:`RELATIVE_UNIT`. All channels are zero where `other` was not
    observed.
    """
    turn = -motions.heading[target][:, None]
    offset = rotate(motions.path[other] - motions.position[target][:, None], turn)
    velocity = rotate(motions.velocity[other], turn)
    r = offset.norm(dim=-1)
    away = r > AT_ORIGIN
    unit = torch.where(away[..., None], offset / r.clamp_min(AT_ORIGIN)[..., None], 0.0)
    radial = torch.where(away, (unit * velocity).sum(dim=-1), -velocity.norm(dim=-1))
    relative = (velocity - rotate(motions.velocity[target, -1], turn[:, 0])[:, None]) / RELATIVE_UNIT
    observed = motions.observed[other].to(r.dtype)
    channels = [r / LENGTH_UNIT, unit[..., 0], unit[..., 1], radial / SPEED_UNIT, *relative.unbind(-1), observed]
    return torch.stack(channels, dim=-1) * observed[..., None]


def neighbours(batch: SceneBatch, asked: Tensor | None = None) -> Neighbours:
    """Returns the agents in the grid of :data:`GRID_ROWS` by :data:`GRID_COLUMNS` cells along each target's frame.

    Neighbours are ranked by the mean of two distances, the smallest first: the present one, and that of the closest
    approach within :data:`APPROACH_S` at present velocities. Targets are the agents `asked` of one scene, or all.
    """
    velocity, offset = velocities(batch), rows_of(offsets(batch), asked)
    approach = velocity[:, None] - rows_of(velocity, asked)[:, :, None]
    squared = (approach**2).sum(dim=-1)
    when = (-(offset * approach).sum(dim=-1) / squared.clamp_min(1e-6)).clamp(0.0, APPROACH_S)
    key = offset.norm(dim=-1) + (offset + when[..., None] * approach).norm(dim=-1)

    local = rotate(offset, -rows_of(batch.heading, asked)[..., None])
    row = torch.floor(local[..., 0] / CELL_LENGTH + 0.5 * GRID_ROWS).long()
    column = torch.floor(local[..., 1] / CELL_WIDTH + 0.5 * GRID_COLUMNS).long()
    inside = (row >= 0) & (row < GRID_ROWS) & (column >= 0) & (column < GRID_COLUMNS)
    pair = inside & other_agents(batch, asked)
    rank = key.masked_fill(~pair, torch.inf).argsort(dim=-1).argsort(dim=-1)

    scene, target, other = pair.nonzero(as_tuple=True)
    cell = (row * GRID_COLUMNS + column)[pair]
    return Neighbours(
        places(rows_of(batch.agent, asked))[scene, target], places(batch.agent)[scene, other], cell, rank[pair]
    )


def slots_of(target: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Arrange P pairs in R slots for each of T = `count` targets; `target` (P,) is ascending.

    R is one more than the largest number of neighbours of a target.

    Returns:
        indices (T, R) of the pairs, P in unused slots, which is the dummy pair of :meth:`Neighbours.and_nobody`; and
        the mask (T, R) of used slots.
    """
    mine = (target == torch.arange(count, device=target.device)[:, None]).long().sum(dim=1, keepdim=True)
    most = cast(int, mine.max())  # remains a tensor, which a trace does not take for a constant
    slot = torch.arange(most + 1, device=target.device)
    used = slot < mine
    return torch.where(used, mine.cumsum(dim=0) - mine + slot, target.shape[0]), used


def rank_encoding(rank: Tensor, size: int) -> Tensor:
    """Returns sinusoidal encodings (P, size) of ranks (P,), like the positional encoding of transformers."""
    frequency = torch.exp(torch.arange(0, size, 2, device=rank.device) * (-math.log(10_000.0) / size))
    angle = rank[:, None] * frequency
    return torch.stack([angle.sin(), angle.cos()], dim=-1).flatten(1)


def last_state(lstm: nn.LSTM, series: Tensor) -> Tensor:
    """Returns the hidden state (S, units) of `lstm` after the last step of `series` (S, steps, channels)."""
    state: Tensor = lstm(series)[1][0][-1]
    return state
