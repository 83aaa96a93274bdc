"""Policy C's network for training in torch; policy C drives with the same weights, without torch."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from scipy.special import log_ndtr
from torch import Tensor, nn

from litsim_policy.driving.action import ACTIONS, HIGH, LOW
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.features.scales import ACCELERATION
from litsim_policy.driving.policy_network import FORMAT, HIDDEN, LAYERS, PolicyNetwork
from litsim_policy.driving.safety.comfort import ACCELERATION_MAX, BRAKING_JERK_MAX, DECELERATION_MAX, JERK_MAX
from litsim_research.predictors.checkpoint import save_weights
from litsim_sim.core.scene import STEP_S, FloatArray

LOG_STD_START = (-1.2, -2.5, -2.5)  # of the actions before tanh: accelerations vary more than steering
BOUND_MAX = 0.999  # largest action for which the inverse of tanh is taken
SQUASH_FLOOR = 1e-6  # keeps the density finite where an action is close to +-1


class StochasticPolicy(nn.Module):
    """A Gaussian over actions, whose mean depends on the observation by dense layers with tanh between them.

    Subclasses make the layers, which have the names :attr:`layers`.

    Attributes:
        log_std: (actions,) logarithms of the standard deviations, before they are clamped to :attr:`log_std_range`.
    """

    layers: ClassVar[tuple[str, ...]]
    log_std_range: ClassVar[tuple[float, float]]
    log_std: nn.Parameter

    def forward(self, observation: Tensor) -> Tensor:
        """Returns means (m, actions) of the Gaussians, for observations (m, size)."""
        values = observation
        for name in self.layers[:-1]:
            values = torch.tanh(self.get_submodule(name)(values))
        means: Tensor = self.get_submodule(self.layers[-1])(values)
        return means

    @abstractmethod
    def deterministic(self, observation: Tensor) -> Tensor:
        """Returns actions (m, actions) at the centre of the density, for observations (m, size)."""

    @abstractmethod
    def log_probability(self, observation: Tensor, raw: Tensor) -> Tensor:
        """Returns the logarithm of the density (m,) of actions `raw` (m, actions), as drawn, at observations."""

    def draw(self, observation: Tensor, generator: torch.Generator) -> Tensor:
        """Returns actions (m, actions) drawn from the Gaussians, for observations (m, size)."""
        with torch.no_grad():
            mean = self(observation)
            return mean + self.std() * torch.randn(mean.shape, generator=generator)

    def entropy(self) -> Tensor:
        """Returns the entropy of the Gaussian, a scalar in nats; that of a squashed one has no closed form."""
        return (torch.log(self.std()) + 0.5 * np.log(2.0 * np.pi * np.e)).sum()

    def std(self) -> Tensor:
        """Returns the standard deviations (actions,) of the Gaussians."""
        return torch.exp(torch.clamp(self.log_std, *self.log_std_range))


class GaussianPolicy(StochasticPolicy):
    """A Gaussian before tanh, which squashes it into actions in [-1, 1]."""

    layers, log_std_range = LAYERS, (-4.0, 0.0)

    def __init__(self, observation: ObservationConfig) -> None:
        super().__init__()
        self.observation = observation
        self.hidden0 = nn.Linear(observation.size, HIDDEN)
        self.hidden1 = nn.Linear(HIDDEN, HIDDEN)
        self.mean = nn.Linear(HIDDEN, len(ACTIONS))
        self.log_std = nn.Parameter(torch.tensor(LOG_STD_START))
        for layer, gain in ((self.hidden0, 2**0.5), (self.hidden1, 2**0.5), (self.mean, 0.01)):
            nn.init.orthogonal_(layer.weight, gain)
            nn.init.zeros_(layer.bias)

    def deterministic(self, observation: Tensor) -> Tensor:
        """See :class:`StochasticPolicy`; actions are in [-1, 1]."""
        return torch.tanh(self(observation))

    def log_probability(self, observation: Tensor, raw: Tensor) -> Tensor:
        """Logarithm of the density (m,) of the actions `raw` (m, 3), before tanh, as they are executed.

        Accelerations beyond the bounds on jerk are clipped, so that such a draw has the probability of all draws
        beyond the bound (Fujita 2018). Most draws are clipped, and would otherwise add noise to the gradient.
        """
        mean, std = self(observation), self.std()
        # validation of the arguments would take longer than the density
        gaussian = torch.distributions.Normal(mean, std, validate_args=False).log_prob(raw)
        density = gaussian - torch.log(1.0 - torch.tanh(raw) ** 2 + SQUASH_FLOOR)
        low, high = (torch.as_tensor(bound, dtype=mean.dtype) for bound in pedal_bounds(observation.numpy()))
        below = torch.special.log_ndtr((low - mean[:, 0]) / std[0])
        above = torch.special.log_ndtr((mean[:, 0] - high) / std[0])
        pedal = torch.where(raw[:, 0] <= low, below, torch.where(raw[:, 0] >= high, above, density[:, 0]))
        return pedal + density[:, 1] + density[:, 2]


def pedal_bounds(observation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest acceleration within the bounds on jerk, (m,) each, as actions before tanh.

    Args:
        observation: (m, size).
    """
    rise, fall = JERK_MAX * STEP_S, BRAKING_JERK_MAX * STEP_S
    before = np.clip(observation[:, 3] * ACCELERATION, -DECELERATION_MAX, ACCELERATION_MAX)
    low, high = np.maximum(before - fall, -DECELERATION_MAX), np.minimum(before + rise, ACCELERATION_MAX)
    scaled = (np.where(bound < 0.0, -bound / LOW[0], bound / HIGH[0]) for bound in (low, high))
    below, above = (np.arctanh(np.clip(bound, -BOUND_MAX, BOUND_MAX)) for bound in scaled)
    return below, above


@dataclass(frozen=True)
class Sampler:
    """A :class:`GaussianPolicy` for driving episodes: an agent's action does not depend on the other rows.

    Attributes:
        network: of the means.
        std: (3,) standard deviations of the actions before tanh.
    """

    network: PolicyNetwork
    std: FloatArray

    @classmethod
    def of(cls, policy: GaussianPolicy) -> Sampler:
        """Return the sampler of `policy` with its current weights."""
        return cls(driving_network(policy), policy.std().detach().double().numpy())

    def sample(self, observation: FloatArray, noise: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Actions for observations (m, size), by standard normal `noise` (m, 3); None for the means.

        Returns:
            the actions before tanh (m, 3), and the logarithms of their densities after tanh (m,).
        """
        mean = self.network.outputs(observation)
        raw = mean if noise is None else mean + self.std * noise
        gaussian = -0.5 * ((raw - mean) / self.std) ** 2 - np.log(self.std) - 0.5 * np.log(2.0 * np.pi)
        density = gaussian - np.log(1.0 - np.tanh(raw) ** 2 + SQUASH_FLOOR)
        low, high = pedal_bounds(observation)
        below, above = log_ndtr((low - mean[:, 0]) / self.std[0]), log_ndtr((mean[:, 0] - high) / self.std[0])
        density[:, 0] = np.where(raw[:, 0] <= low, below, np.where(raw[:, 0] >= high, above, density[:, 0]))
        return raw, density.sum(axis=1)


def multilayer(inputs: int, outputs: int) -> nn.Sequential:
    """A new network from (m, `inputs`) to (m, `outputs`), with hidden layers as the policy's; for value and critic."""
    layers = [nn.Linear(inputs, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, outputs)]
    return nn.Sequential(*layers)


def driving_network(policy: GaussianPolicy) -> PolicyNetwork:
    """The network that drives by the means of `policy`, with its weights as float64 numpy arrays."""
    arrays = {name: value.detach().double().numpy() for name, value in policy.state_dict().items()}
    weights = tuple(np.ascontiguousarray(arrays[f"{layer}.weight"].T) for layer in LAYERS)
    return PolicyNetwork(weights, tuple(arrays[f"{layer}.bias"] for layer in LAYERS), policy.observation)


def save(policy: GaussianPolicy, path: Path, about: dict[str, str] | None = None) -> None:
    """Write the weights for :meth:`PolicyNetwork.load`, with `about` as metadata on their origin.

    Raises:
        Unwritable: the file cannot be written; what was there is kept.
    """
    observation = {f"observation.{field}": str(value) for field, value in vars(policy.observation).items()}
    save_weights(policy.state_dict(), {"format": FORMAT, **observation, **(about or {})}, path)
