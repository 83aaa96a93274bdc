"""Attention of the agents of a scene to those near them in the joint predictor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import STATE_CHANNELS
from litsim_predictor.inference.joint.units import (
    LANE,
    NEAR,
    RELATION_CHANNELS,
    RELATION_UNITS,
    RELATION_WIDTH,
    STATE_UNITS,
)
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.models.model import chosen, linear_of, rows_of, same_agent


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
        """Returns the neighbours of the rows `agents` (M,) only; of all rows for None."""
        dim = self.index.dim() - 2
        return Neighbours(*(rows_of(v, agents, dim) for v in (self.index, self.seen, self.relation)))


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
        """Returns codes (..., N, width): `agents` plus attention to those `near` each of them, normalised.

        With `asked` (M,), only the codes (..., M, width) of these rows; `near` must then be that of these rows.
        """
        size = self.width // self.heads

        def by_head(values: Tensor) -> Tensor:
            """Returns `values` (..., N, width) by head: (..., heads, N, size)."""
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
        similarity = query @ key.transpose(-1, -2)
        logits = similarity.gather(-1, index) + (wanted @ related.transpose(-1, -2)).transpose(-2, -3)
        weights = logits.masked_fill(~near.seen.unsqueeze(-3), float("-inf")).softmax(dim=-1)  # (..., heads, M, K)
        related_value = (weights.transpose(-2, -3) @ related).transpose(-2, -3) @ of_value.transpose(-1, -2)
        attended = torch.zeros_like(similarity).scatter(-1, index, weights) @ value + related_value
        attended = attended.transpose(-2, -3).reshape(*asking.shape[:-2], -1, self.width)
        return cast(Tensor, self.norm(asking + self.out(attended)))


class PairAttention(nn.Module):
    """The paper's dynamic encoder: the state of each agent attends to those of others, relative to it.

    The paper has them in a frame common to the scene, in which they are hundreds of metres apart.

    Args:
        width: of the codes.
        heads: of the attention.
        neighbours: greatest number of nearest others that an agent attends to, beside itself.
        reach: distance within which these must be [m].
    """

    def __init__(self, width: int, heads: int, neighbours: int, reach: float) -> None:
        super().__init__()
        self.heads, self.neighbours, self.reach = heads, neighbours, reach
        self.embed = nn.Sequential(nn.Linear(STATE_CHANNELS, width), nn.ReLU())
        self.query = nn.Linear(width, width)
        self.pair = nn.Sequential(
            nn.Linear(RELATION_CHANNELS, RELATION_WIDTH), nn.ReLU(), nn.Linear(RELATION_WIDTH, 2 * width)
        )
        self.out = nn.Linear(width, width)

    def forward(self, batch: SceneBatch) -> Tensor:
        """Returns codes (..., N, width) of all agents of `batch`."""
        near = Neighbours.of(batch, self.neighbours, self.reach)
        own = self.embed[1](linear_of(batch.state, batch.state.new_tensor(STATE_UNITS), cast(nn.Linear, self.embed[0])))
        first = cast(nn.Linear, self.pair[0])
        pairs = self.pair[1:](linear_of(near.relation, near.relation.new_tensor(RELATION_UNITS), first))
        size = own.shape[-1] // self.heads
        key, value = pairs.view(*pairs.shape[:-1], 2, self.heads, size).unbind(dim=-3)  # (..., N, K, heads, size)
        query = self.query(own).view(*own.shape[:-1], 1, self.heads, size)
        logits = (query * key).sum(dim=-1) * size**-0.5
        weights = logits.masked_fill(~near.seen[..., None], float("-inf")).softmax(dim=-2)
        return cast(Tensor, own + self.out((weights[..., None] * value).sum(dim=-3).flatten(-2)))
