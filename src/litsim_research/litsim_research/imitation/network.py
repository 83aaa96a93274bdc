"""The networks of GAIL for training in torch: policy, critic and value, of the same size."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from litsim_policy.driving.features.traffic_observation import SIZE
from litsim_research.baselines.imitation_policy import BOUNDS, FORMAT, HIDDEN, LAYERS, TURNING, Turning
from litsim_research.policies.network import StochasticPolicy
from litsim_research.predictors.checkpoint import save_weights

LOG_STD_START = -1.0


class TrafficPolicy(StochasticPolicy):
    """A Gaussian over accelerations and yaw rates, as shares of :func:`.imitation_policy.largest`.

    Attributes:
        turning: what yaw rate action 1 is.
    """

    layers, log_std_range = LAYERS, (-3.0, 0.0)

    def __init__(self, turning: Turning = "published") -> None:
        super().__init__()
        self.turning: Turning = turning
        sizes = (SIZE, *HIDDEN, len(BOUNDS))
        for name, inputs, outputs in zip(LAYERS, sizes, sizes[1:], strict=False):
            layer = nn.Linear(inputs, outputs)
            nn.init.orthogonal_(layer.weight, 0.01 if name == LAYERS[-1] else 2**0.5)
            nn.init.zeros_(layer.bias)
            self.add_module(name, layer)
        self.log_std = nn.Parameter(torch.full((len(BOUNDS),), LOG_STD_START))

    def deterministic(self, observation: Tensor) -> Tensor:
        """See :class:`.StochasticPolicy`."""
        return self.forward(observation)

    def log_probability(self, observation: Tensor, raw: Tensor) -> Tensor:
        """Returns the logarithm of the density (m,) of actions `raw` (m, 2) as drawn, before driving clips them."""
        # validation of the arguments would take longer than the density
        return torch.distributions.Normal(self(observation), self.std(), validate_args=False).log_prob(raw).sum(dim=-1)


def perceptron(inputs: int, dropout: float = 0.0) -> nn.Sequential:
    """Returns a new network from (m, `inputs`) to (m, 1) with ReLU activations, for critic and value."""
    layers: list[nn.Module] = []
    for before, after in zip((inputs, *HIDDEN), HIDDEN, strict=False):
        layers += [nn.Linear(before, after), nn.ReLU(), nn.Dropout(dropout)]
    return nn.Sequential(*layers, nn.Linear(HIDDEN[-1], 1))


def save(policy: TrafficPolicy, path: Path, about: dict[str, str]) -> None:
    """Write the weights for :meth:`litsim_research.baselines.imitation_policy.ImitationNetwork.load`.

    Raises:
        Unwritable: the file cannot be written; what was there is kept.
    """
    tensors = policy.state_dict() | {"log_std": torch.log(policy.std())}
    save_weights(tensors, {"format": FORMAT, TURNING: policy.turning, **about}, path)
