"""Policy C's network as torch trains it; policy C itself drives with its weights, and without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from litsim_policy.driving.action import ACTIONS
from litsim_policy.driving.observation import ObservationConfig
from litsim_policy.driving.policy_c import FORMAT, HIDDEN, PolicyNetwork
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray

LOG_STD_START = (-1.2, -2.5, -2.5)  # of the actions before tanh: pedals vary more than steering
LOG_STD_MIN, LOG_STD_MAX = -4.0, 0.0
SQUASH_FLOOR = 1e-6  # keeps the density finite where an action is all but 1


class GaussianPolicy(nn.Module):
    """A Gaussian whose mean depends on the observation, squashed by tanh into actions in [-1, 1]."""

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

    def forward(self, observation: Tensor) -> Tensor:
        """Means (m, 3) of the Gaussians before tanh, for observations (m, size)."""
        hidden = torch.tanh(self.hidden1(torch.tanh(self.hidden0(observation))))
        values: Tensor = self.mean(hidden)
        return values

    def said(self, observation: Tensor) -> Tensor:
        """Actions (m, 3) in [-1, 1] by which it drives, for observations (m, size)."""
        return torch.tanh(self(observation))

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Draw actions for observations (m, size).

        Returns:
            the actions before tanh (m, 3), and the logarithm of the density of what tanh makes of them (m,).
        """
        with torch.no_grad():
            mean = self(observation)
            raw = mean + self.std() * torch.randn(mean.shape, generator=generator)
            return raw, self._log_density(mean, raw)

    def log_probability(self, observation: Tensor, raw: Tensor) -> Tensor:
        """Logarithm of the density (m,) of the squashed actions, given as they are before tanh (m, 3)."""
        return self._log_density(self(observation), raw)

    def entropy(self) -> Tensor:
        """Entropy of the Gaussian before tanh, a scalar in nats; that of the squashed one has no closed form."""
        return (torch.log(self.std()) + 0.5 * np.log(2.0 * np.pi * np.e)).sum()

    def std(self) -> Tensor:
        """Standard deviations (3,) of the actions before tanh."""
        return torch.exp(torch.clamp(self.log_std, LOG_STD_MIN, LOG_STD_MAX))

    def _log_density(self, mean: Tensor, raw: Tensor) -> Tensor:
        # checking the arguments would take longer than the density
        gaussian = torch.distributions.Normal(mean, self.std(), validate_args=False).log_prob(raw)
        return (gaussian - torch.log(1.0 - torch.tanh(raw) ** 2 + SQUASH_FLOOR)).sum(dim=-1)


@dataclass(frozen=True)
class Sampler:
    """A :class:`GaussianPolicy` as episodes are driven with it: what it draws for an agent depends on no other.

    Attributes:
        network: of the means.
        std: (3,) of the actions before tanh.
    """

    network: PolicyNetwork
    std: FloatArray

    @classmethod
    def of(cls, policy: GaussianPolicy) -> Sampler:
        """Return that of `policy` with its weights of now."""
        return cls(driving_network(policy), policy.std().detach().double().numpy())

    def sample(self, observation: FloatArray, noise: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Actions for observations (m, size), by standard normal `noise` (m, 3); None is none, the mean.

        Returns:
            as :meth:`GaussianPolicy.sample`.
        """
        mean = self.network.before_tanh(observation)
        raw = mean if noise is None else mean + self.std * noise
        gaussian = -0.5 * ((raw - mean) / self.std) ** 2 - np.log(self.std) - 0.5 * np.log(2.0 * np.pi)
        return raw, (gaussian - np.log(1.0 - np.tanh(raw) ** 2 + SQUASH_FLOOR)).sum(axis=1)


def multilayer(inputs: int, outputs: int) -> nn.Sequential:
    """A fresh network from (m, `inputs`) to (m, `outputs`), for value and critic: two hidden layers as the policy's."""
    layers = [nn.Linear(inputs, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, outputs)]
    return nn.Sequential(*layers)


def driving_network(policy: GaussianPolicy) -> PolicyNetwork:
    """The network that drives by the means of `policy` after tanh: its weights as numpy arrays, float64."""
    layers = (policy.hidden0, policy.hidden1, policy.mean)
    arrays = [(layer.weight.detach().double().numpy(), layer.bias.detach().double().numpy()) for layer in layers]
    return PolicyNetwork(
        tuple(np.ascontiguousarray(weight.T) for weight, _ in arrays),
        tuple(bias.copy() for _, bias in arrays),
        policy.observation,
    )


def save(policy: GaussianPolicy, path: Path, about: dict[str, str] | None = None) -> None:
    """Write what :meth:`PolicyNetwork.load` reads; `about` says where the weights come from."""
    tensors = {name: tensor.detach().contiguous() for name, tensor in policy.state_dict().items()}
    observation = {f"observation.{field}": str(value) for field, value in vars(policy.observation).items()}
    save_file(tensors, str(path), {"format": FORMAT, **observation, **(about or {})})


def restore(policy: GaussianPolicy, path: Path) -> None:
    """Give `policy` the weights that :func:`save` has written to `path`; changes it in place.

    Raises:
        InputError: the file is missing, damaged, or of a network that sees something else.
    """
    saved = PolicyNetwork.load(path)
    if saved.observation != policy.observation:
        raise InputError(f"{path}: was trained to see {saved.observation}, expected {policy.observation}")
    policy.load_state_dict(load_file(str(path)))
