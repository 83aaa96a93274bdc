"""What every learned predictor is: a torch module from scenes to manoeuvre-conditioned Gaussians."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Literal

import torch
from torch import Tensor, nn

from litsim_predictor.inference.contract import DT, HORIZON, LATERAL, LONGITUDINAL
from litsim_predictor.inference.joint_units import CORRELATION_LIMIT, SCALE_FLOOR
from litsim_predictor.learned.data.batch import Prediction, SceneBatch

Decode = Literal["all", "best"] | Tensor
"""What to decode; see :meth:`SceneModel.forward`."""


class SceneModel(nn.Module):
    """Base of all learned predictors.

    A subclass is built from its configuration alone. It answers with finite numbers for padding, too, and for agents
    that are seen in a single frame. Its answers depend neither on the order of agents nor on padding.

    Attributes:
        forcing: share of the batches of training in which a decoder that reads positions is given the true ones.
    """

    forcing = 0.0

    @abstractmethod
    def forward(self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None) -> Prediction:
        """Predict every agent of `batch`, in one pass.

        Args:
            batch: scenes; nothing of its future is read, except by teacher forcing while `self.training`.
            decode: "all" for one trajectory for each manoeuvre (M = K), "best" for that of the most probable one
                (M = 1), or manoeuvres (B, N) int64, such as the true ones in training (M = 1; -1 stands for best).
            asked: (A,) int64 agents of a single scene (B = 1) who alone are predicted, among all the others; what is
                answered then has the shapes of A agents, in their order. None asks for everybody.
        """


def decoded_maneuvers(logits: Tensor, decode: Decode) -> Tensor:
    """(B, N, M) int64 the manoeuvres to decode, of logits (B, N, K); see :meth:`SceneModel.forward`."""
    if isinstance(decode, str) and decode == "all":
        return torch.arange(logits.shape[-1], device=logits.device).expand_as(logits)
    best = logits.argmax(dim=-1)
    return (best if isinstance(decode, str) else torch.where(decode >= 0, decode, best))[..., None]


def maneuver_logits(lateral: Tensor, longitudinal: Tensor) -> Tensor:
    """(..., K) logits of manoeuvres whose two parts are independent, from theirs: (..., 3) each."""
    return (lateral.log_softmax(-1)[..., :, None] + longitudinal.log_softmax(-1)[..., None, :]).flatten(-2)


def maneuver_parts(maneuver: Tensor) -> Tensor:
    """(..., 6) int64: the lateral part of manoeuvres (...) one-hot, then the longitudinal one."""
    lateral = nn.functional.one_hot(maneuver // len(LONGITUDINAL), len(LATERAL))
    return torch.cat([lateral, nn.functional.one_hot(maneuver % len(LONGITUDINAL), len(LONGITUDINAL))], dim=-1)


def rotate(vector: Tensor, angle: Tensor) -> Tensor:
    """The vectors (..., 2) turned counter-clockwise by the angles (...) [rad]."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vector[..., 0], vector[..., 1]
    return torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)


def offsets(batch: SceneBatch) -> Tensor:
    """(B, N, N, 2) from each agent (first N) to every agent (second N), in the axes of frame map [m].

    Turned by ``-batch.heading[..., None]``, they are ahead of the first and to its left.
    """
    return batch.position[:, None] - batch.position[:, :, None]


def same_agent(batch: SceneBatch) -> Tensor:
    """(N, N) bool, True where the first agent is the second."""
    return diagonal(batch.heading)


def diagonal(like: Tensor) -> Tensor:
    """(N, N) bool, True on the diagonal, on the device of `like` (..., N)."""
    place = torch.arange(like.shape[-1], device=like.device)  # torch.eye has no counterpart of bool in ONNX Runtime
    return place[:, None] == place


def present(values: Tensor, agent: Tensor) -> Tensor:
    """(T, ...) of values (B, N, ...): those of the T agents that are no padding, in the order of `agent` (B, N).

    Of one scene as it is, agents (N,), it is all values (N, ...).
    """
    if agent.dim() == 1:
        return values
    # An exported graph is of one scene, and there is no padding in that.
    return values.squeeze(0) if torch.onnx.is_in_onnx_export() else values[agent]


def padded(values: Tensor, agent: Tensor) -> Tensor:
    """(B, N, ...) of values (T, ...), zeros where there is only padding; the reverse of :func:`present`."""
    if agent.dim() == 1:
        return values
    if torch.onnx.is_in_onnx_export():
        return values[None]
    everywhere = values.new_zeros(*agent.shape, *values.shape[1:])
    everywhere[agent] = values
    return everywhere


def places(agent: Tensor) -> Tensor:
    """(B, N) places in one list of the agents (B, N) that are no padding."""
    return (agent.flatten().long().cumsum(dim=0) - 1).view_as(agent)


def rows_of(values: Tensor, agents: Tensor | None, dim: int = 1) -> Tensor:
    """(B, M, ...) of values (B, N, ...), N their dimension `dim`: those of `agents` (M,); all where that is None."""
    return values if agents is None else values.index_select(dim, agents)


def chosen(values: Tensor, index: Tensor) -> Tensor:
    """(B, M, K, ...) of values (B, N, ...): of each scene those of the agents `index` (B, M, K); or all without B."""
    if index.dim() == 2:
        return values[index]
    return values[torch.arange(len(values), device=index.device)[:, None, None], index]


def linear_of(values: Tensor, units: Tensor, layer: nn.Linear) -> Tensor:
    """`layer` of the values (..., C), each channel divided by one of the `units` (C,).

    The weights are divided, which are fewer than the values; and a compiled graph does so once, when it is loaded.
    """
    return nn.functional.linear(values, layer.weight / units, layer.bias)


def future_times(like: Tensor) -> Tensor:
    """(HORIZON,) the steps of the future [s], on the device and of the type of `like`."""
    return DT * torch.arange(1, HORIZON + 1, device=like.device, dtype=like.dtype)


def constant_velocity(state: Tensor) -> Tensor:
    """(..., HORIZON, 2) positions at constant speed along the heading, in the agent frame [m], of states (..., 4)."""
    speed, yaw = state[..., 2:3], state[..., 3:]
    velocity = speed * torch.cat([yaw.cos(), yaw.sin()], dim=-1)
    return velocity[..., None, :] * future_times(speed)[:, None]


def gaussian(raw: Tensor) -> tuple[Tensor, Tensor]:
    """Standard deviations (..., 2) [m] and correlation (...,) from three unbounded channels (..., 3)."""
    scale = nn.functional.softplus(raw[..., :2]) + SCALE_FLOOR
    return scale, CORRELATION_LIMIT * torch.tanh(raw[..., 2])


def mahalanobis_squared(prediction: Prediction, future: Tensor) -> Tensor:
    """(B, N, M, HORIZON) of true positions `future` (B, N, HORIZON, 2) from the means of the Gaussians."""
    z = (future[:, :, None] - prediction.mean) / prediction.scale
    rho = prediction.correlation
    return (z[..., 0] ** 2 + z[..., 1] ** 2 - 2.0 * rho * z[..., 0] * z[..., 1]) / (1.0 - rho**2)


def negative_log_likelihood(prediction: Prediction, future: Tensor) -> Tensor:
    """(B, N, M, HORIZON) of true positions `future` (B, N, HORIZON, 2) under the Gaussians [nats, density in 1/m2]."""
    area = prediction.scale.log().sum(dim=-1) + 0.5 * (1.0 - prediction.correlation**2).log()
    return 0.5 * mahalanobis_squared(prediction, future) + area + math.log(2.0 * math.pi)
