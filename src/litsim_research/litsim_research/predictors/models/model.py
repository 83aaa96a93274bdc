"""The base class of all learned predictors, torch modules that map scenes to manoeuvre-conditioned Gaussians."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Literal

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, HORIZON, LATERAL, LONGITUDINAL
from litsim_predictor.inference.joint.units import CORRELATION_LIMIT, SCALE_FLOOR
from litsim_research.predictors.data.batch import Prediction, SceneBatch

Decode = Literal["all", "best"] | Tensor
"""Which manoeuvres to decode; see :meth:`SceneModel.forward`."""


class SceneModel(nn.Module):
    """Base of all learned predictors.

    A subclass is built from its configuration alone. Its outputs are finite, for padding and for agents observed in a
    single frame as well, and depend neither on the order of the agents nor on the amount of padding.

    Attributes:
        forcing: share of training batches with teacher forcing, in which a decoder that reads positions is given the
            true ones.
        sees_signals: whether closed stop lines are to be among the agents, as in its training.
    """

    forcing = 0.0
    sees_signals = False

    @abstractmethod
    def forward(self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None) -> Prediction:
        """Predict all agents of `batch`, or those `asked`, in one pass.

        Args:
            batch: scenes; their futures are not read, except for teacher forcing while `self.training`.
            decode: "all" for one trajectory for each manoeuvre (M = K), "best" for that of the most probable one
                (M = 1), or manoeuvres (B, N) int64, such as the true ones in training (M = 1; -1 stands for best).
            asked: (A,) int64 indices of the agents of a single scene (B = 1) that are predicted; the others are context
                only. The prediction then has N = A agents, in this order. None predicts all agents.
        """


def decoded_maneuvers(logits: Tensor, decode: Decode) -> Tensor:
    """Returns manoeuvres (B, N, M) int64 to decode, for logits (B, N, K); see :meth:`SceneModel.forward`."""
    if isinstance(decode, str) and decode == "all":
        return torch.arange(logits.shape[-1], device=logits.device).expand_as(logits)
    best = logits.argmax(dim=-1)
    return (best if isinstance(decode, str) else torch.where(decode >= 0, decode, best))[..., None]


def maneuver_logits(lateral: Tensor, longitudinal: Tensor) -> Tensor:
    """Returns logits (..., K) of manoeuvres whose parts are independent, from logits (..., 3) of each part."""
    return (lateral.log_softmax(-1)[..., :, None] + longitudinal.log_softmax(-1)[..., None, :]).flatten(-2)


def maneuver_parts(maneuver: Tensor) -> Tensor:
    """Returns one-hot encodings (..., 6) int64 of manoeuvres (...): the lateral part, then the longitudinal one."""
    lateral = nn.functional.one_hot(maneuver // len(LONGITUDINAL), len(LATERAL))
    return torch.cat([lateral, nn.functional.one_hot(maneuver % len(LONGITUDINAL), len(LONGITUDINAL))], dim=-1)


def rotate(vector: Tensor, angle: Tensor) -> Tensor:
    """Returns vectors (..., 2), rotated counter-clockwise by angles (...) [rad]."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vector[..., 0], vector[..., 1]
    return torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)


def offsets(batch: SceneBatch) -> Tensor:
    """Returns offsets (B, N, N, 2) from each agent (first N) to every agent (second N), in the axes of frame map [m].

    Rotated by ``-batch.heading[..., None]``, they are ahead of the first agent and to its left.
    """
    return batch.position[:, None] - batch.position[:, :, None]


def velocities(batch: SceneBatch) -> Tensor:
    """Returns present velocities (B, N, 2) of all agents, in the axes of frame map [m/s]."""
    speed, yaw = batch.state[..., 2], batch.heading + batch.state[..., 3]
    return speed[..., None] * torch.stack([yaw.cos(), yaw.sin()], dim=-1)


def other_agents(batch: SceneBatch, asked: Tensor | None) -> Tensor:
    """Returns a mask (B, M, N) of the pairs of a target and another agent, neither of which is padding.

    The M targets are the agents `asked` of one scene, or all agents.
    """
    itself = same_agent(batch)
    apart = ~(itself if asked is None else itself[asked])
    return apart & rows_of(batch.agent, asked)[:, :, None] & batch.agent[:, None]


def same_agent(batch: SceneBatch) -> Tensor:
    """Returns a mask (N, N) of the pairs of an agent with itself."""
    return diagonal(batch.heading)


def diagonal(like: Tensor) -> Tensor:
    """Returns a mask (N, N) that is True on the diagonal, on the device of `like` (..., N)."""
    place = torch.arange(like.shape[-1], device=like.device)  # ONNX Runtime has no counterpart of torch.eye for bool
    return place[:, None] == place


def present(values: Tensor, agent: Tensor) -> Tensor:
    """Returns values (T, ...) of agents that are not padding, from `values` (B, N, ...) and the mask `agent` (B, N).

    For one scene without the dimension B, with `agent` (N,), these are all `values` (N, ...).
    """
    if agent.dim() == 1:
        return values
    # An exported graph is for one scene, without padding.
    return values.squeeze(0) if torch.onnx.is_in_onnx_export() else values[agent]


def padded(values: Tensor, agent: Tensor) -> Tensor:
    """Returns the inverse of :func:`present`: (B, N, ...) from `values` (T, ...), with zeros for padding."""
    if agent.dim() == 1:
        return values
    if torch.onnx.is_in_onnx_export():
        return values[None]
    everywhere = values.new_zeros(*agent.shape, *values.shape[1:])
    everywhere[agent] = values
    return everywhere


def places(agent: Tensor) -> Tensor:
    """Returns indices (B, N) of the agents `agent` (B, N) in the output of :func:`present`; arbitrary for padding."""
    return (agent.flatten().long().cumsum(dim=0) - 1).view_as(agent)


def rows_of(values: Tensor, agents: Tensor | None, dim: int = 1) -> Tensor:
    """Returns values (B, M, ...) of `agents` (M,), from `values` (B, N, ...) with agents along `dim`; all for None."""
    return values if agents is None else values.index_select(dim, agents)


def chosen(values: Tensor, index: Tensor) -> Tensor:
    """Returns values (B, M, K, ...) of the agents `index` (B, M, K) of each scene, from `values` (B, N, ...)."""
    if index.dim() == 2:
        return values[index]
    return values[torch.arange(len(values), device=index.device)[:, None, None], index]


def linear_of(values: Tensor, units: Tensor, layer: nn.Linear) -> Tensor:
    """Returns the output of `layer` for `values` (..., C) whose channels are divided by `units` (C,).

    The weights are divided instead, which are fewer than the values; a compiled graph does so only once, when loaded.
    """
    return nn.functional.linear(values, layer.weight / units, layer.bias)


def future_times(like: Tensor) -> Tensor:
    """Returns times (HORIZON,) of the future steps [s], with the device and the type of `like`."""
    return DT * torch.arange(1, HORIZON + 1, device=like.device, dtype=like.dtype)


def constant_velocity(state: Tensor) -> Tensor:
    """Returns positions (..., HORIZON, 2) [m] at constant velocity, in the agent frame, for states (..., channels)."""
    speed, yaw = state[..., 2:3], state[..., 3:]
    velocity = speed * torch.cat([yaw.cos(), yaw.sin()], dim=-1)
    return velocity[..., None, :] * future_times(speed)[:, None]


def gaussian(raw: Tensor) -> tuple[Tensor, Tensor]:
    """Returns standard deviations (..., 2) [m] and correlation (...) from unbounded outputs of a network (..., 3)."""
    scale = nn.functional.softplus(raw[..., :2]) + SCALE_FLOOR
    return scale, CORRELATION_LIMIT * torch.tanh(raw[..., 2])


def mahalanobis_squared(prediction: Prediction, future: Tensor) -> Tensor:
    """Returns squared Mahalanobis distances (B, N, M, HORIZON) of true positions `future` (B, N, HORIZON, 2)."""
    z = (future[:, :, None] - prediction.mean) / prediction.scale
    rho = prediction.correlation
    return (z[..., 0] ** 2 + z[..., 1] ** 2 - 2.0 * rho * z[..., 0] * z[..., 1]) / (1.0 - rho**2)


def negative_log_likelihood(prediction: Prediction, future: Tensor) -> Tensor:
    """Returns NLL (B, N, M, HORIZON) [nats, of a density in 1/m2] of true positions `future` (B, N, HORIZON, 2)."""
    area = prediction.scale.log().sum(dim=-1) + 0.5 * (1.0 - prediction.correlation**2).log()
    return 0.5 * mahalanobis_squared(prediction, future) + area + math.log(2.0 * math.pi)
