"""What every learned predictor is: a torch module from scenes to manoeuvre-conditioned Gaussians."""

from __future__ import annotations

import math
from abc import abstractmethod

import torch
from torch import Tensor, nn

from litsim_predictor.learned.batch import DT, HORIZON, Prediction, SceneBatch

SCALE_FLOOR = 0.02  # [m] least standard deviation: below what the recordings measure
CORRELATION_LIMIT = 0.95


class SceneModel(nn.Module):
    """Base of all learned predictors.

    A subclass is built from its configuration alone, and answers for padding and for agents seen in a single frame
    with finite numbers. Answers do not depend on the order of agents nor on padding.

    Attributes:
        forcing: share of the batches of training in which a decoder that reads positions is given the true ones.
    """

    forcing = 0.0

    @abstractmethod
    def forward(self, batch: SceneBatch, decode: str | Tensor = "best") -> Prediction:
        """Predict every agent of `batch`, in one pass.

        Args:
            batch: scenes; nothing of its future is read, except by teacher forcing while `self.training`.
            decode: "all" for one trajectory for each manoeuvre (M = K), "best" for that of the most probable one
                (M = 1), or manoeuvres (B, N) int64, such as the true ones in training (M = 1; -1 stands for best).
        """


def chosen_maneuver(logits: Tensor, decode: str | Tensor) -> Tensor:
    """(B, N) the manoeuvre to decode, for a `decode` of "best" or given manoeuvres."""
    best = logits.argmax(dim=-1)
    return best if isinstance(decode, str) else torch.where(decode >= 0, decode, best)


def constant_velocity(batch: SceneBatch) -> Tensor:
    """(B, N, HORIZON, 2) positions at constant speed along the heading, in the agent frame [m]."""
    speed, yaw = batch.state[..., 2], batch.state[..., 3]
    t = DT * torch.arange(1, HORIZON + 1, device=speed.device, dtype=speed.dtype)
    direction = torch.stack([yaw.cos(), yaw.sin()], dim=-1)
    return speed[..., None, None] * t[:, None] * direction[..., None, :]


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
