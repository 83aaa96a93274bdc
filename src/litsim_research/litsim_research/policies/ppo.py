"""Proximal policy optimisation (Schulman 2017) with generalised advantage estimation, on tracks of many agents."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from litsim_research.policies.network import StochasticPolicy
from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import NonNegative, Number, Positive, Share, Whole, configuration
from litsim_sim.core.scene import BoolArray, FloatArray

BatchSize = Annotated[Whole, Field(gt=0, le=1_000_000)]
"""Pairs or agent-steps in a step of an optimiser; at most as many as there is memory for."""
WEIGHT_MAX = 1e6  # far above the weights of any network here that has learned something


@configuration
class PpoConfig:
    """Parameters of the update; the paper gives a learning rate of 0.03 and batches of 32.

    Attributes:
        learning_rate: of Adam.
        batch: transitions in a step of the optimiser.
        epochs: passes over the transitions of an iteration.
        clip: of the probability ratio.
        discount: per step of 0.1 s.
        gae_lambda: of the generalised advantages.
        vf_coef, ent_coef: weights of the value's squared error and of the entropy in the loss.
        max_grad_norm: norm to which gradients are clipped.
        target_kl: the passes end after one with a larger mean Kullback-Leibler divergence from the policy that
            drove.
        imitation_weight: of the squared error against drivers' actions, in units of their spread, which keeps the
            policy close to drivers while it learns to avoid collisions (behaviour cloning with RL, Lu 2023).
        value_first: first iterations, in which only the value network learns: advantages from an untrained one are
            noise.
    """

    learning_rate: Positive[Number] = 3e-4
    batch: BatchSize = 256
    epochs: Positive[Whole] = 4
    clip: Positive[Number] = 0.2
    discount: Share = 0.98
    gae_lambda: Share = 0.95
    vf_coef: NonNegative[Number] = 0.5
    ent_coef: NonNegative[Number] = 0.001
    max_grad_norm: Positive[Number] = 0.5
    target_kl: Number = 0.01
    imitation_weight: NonNegative[Number] = 0.3
    value_first: NonNegative[Whole] = 3


@dataclass(frozen=True)
class Track:
    """T steps of one agent under the policy.

    Attributes:
        observation: (T + 1, size), the last one after the last step.
        raw: (T, 3) actions before tanh.
        log_probability: (T,) logarithm of the density with which the policy drew them, after tanh.
        executed: (T, 3) executed motion, as actions in [-1, 1].
        penalty: (T,) at most 0.
        terminated: whether the track ended in a collision or off the road, rather than with a hand-over or the end of
            the episode.
        recorded: whether the ego of the episode drove as recorded.
    """

    observation: FloatArray
    raw: FloatArray
    log_probability: FloatArray
    executed: FloatArray
    penalty: FloatArray
    terminated: bool
    recorded: bool = False

    def __len__(self) -> int:
        return len(self.raw)


@dataclass(frozen=True)
class Batch:
    """The m agent-steps of an iteration, of all tracks one after another.

    Attributes:
        observation: (m, size) before the step.
        raw: (m, 3) actions before tanh.
        log_probability: (m,) of them, by the policy that drove.
        advantage: (m,) with mean 0 and standard deviation 1.
        target: (m,) of the value network.
    """

    observation: Tensor
    raw: Tensor
    log_probability: Tensor
    advantage: Tensor
    target: Tensor


@dataclass(frozen=True)
class Demonstrations:
    """Observations and actions of drivers, to which the policy's mean is fitted.

    Attributes:
        observation: (n, size).
        action: (n, actions) in [-1, 1].
        weight: (n,) by which pairs are drawn, with any sum.
    """

    observation: Tensor
    action: Tensor
    weight: Tensor

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """Positions (count,) of pairs, drawn by weight with replacement."""
        until = self._until
        return torch.searchsorted(
            until, until[-1] * torch.rand(count, generator=generator, dtype=torch.float64), right=True
        )

    @cached_property
    def _until(self) -> Tensor:
        """Cumulative sums (n,) of the weights."""
        return torch.cumsum(self.weight.double(), 0)

    def error(self, policy: StochasticPolicy, chosen: Tensor) -> Tensor:
        """Mean squared error on the pairs `chosen` (m,), with actions in units of their spread; a scalar."""
        actions = policy.deterministic(self.observation[chosen])
        return nn.functional.mse_loss(actions / self._scale, self.action[chosen] / self._scale)

    def surprise(self, policy: StochasticPolicy, chosen: Tensor) -> Tensor:
        """Mean negative logarithm of the policy's density at the pairs `chosen` (m,) [nats]; a scalar."""
        return -policy.log_probability(self.observation[chosen], self.action[chosen]).mean()

    @cached_property
    def _scale(self) -> Tensor:
        """Standard deviations (actions,), kept above 0."""
        return self.action.std(dim=0) + 1e-3


def advantages(
    reward: FloatArray, value: FloatArray, config: PpoConfig, *, terminated: bool
) -> tuple[FloatArray, FloatArray]:
    """Generalised advantages (T,) and value targets (T,) of one track.

    Args:
        reward: (T,).
        value: (T + 1,) of the observations.
        config: discount and lambda.
        terminated: whether no reward can follow the last step; otherwise the last value stands for what follows.
    """
    following = value[1:].copy()
    if terminated:
        following[-1] = 0.0
    surprise = reward + config.discount * following - value[:-1]
    found = np.zeros(len(reward))
    carried = 0.0
    for t in range(len(reward) - 1, -1, -1):
        carried = surprise[t] + config.discount * config.gae_lambda * carried
        found[t] = carried
    return found, found + value[:-1]


def make_batch(tracks: list[Track], rewards: list[FloatArray], value: nn.Module, config: PpoConfig) -> Batch:
    """The agent-steps of all `tracks`, with advantages normalised over all of them.

    Args:
        tracks: driven by the policy.
        rewards: (T,) of each track.
        value: the value network.
        config: discount and lambda.
    """
    found = []
    with torch.no_grad():
        for track, reward in zip(tracks, rewards, strict=True):
            values = value(tensor(track.observation))[:, 0].double().numpy()
            found.append(advantages(reward, values, config, terminated=track.terminated))
    advantage = np.concatenate([a for a, _ in found])
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    return Batch(
        tensor(np.concatenate([track.observation[:-1] for track in tracks])),
        tensor(np.concatenate([track.raw for track in tracks])),
        tensor(np.concatenate([track.log_probability for track in tracks])),
        tensor(advantage),
        tensor(np.concatenate([target for _, target in found])),
    )


def update_policy(
    policy: StochasticPolicy,
    value: nn.Module,
    optimiser: torch.optim.Optimizer,
    batch: Batch,
    config: PpoConfig,
    generator: torch.Generator,
    demonstrations: Demonstrations | None = None,
    *,
    value_only: bool = False,
) -> dict[str, float]:
    """Make passes over `batch` in random order, in full minibatches (the remainder of a pass is left out).

    Returns means over the minibatches: `value_loss`, the squared error of the value network; `divergence`, the
    Kullback-Leibler divergence from the policy that drove; `clipped`, the share of agent-steps whose probability ratio
    was clipped.

    Args:
        policy, value: to update.
        optimiser: of the parameters of both.
        batch: driven by the policy.
        config: of the update.
        generator: of the order, and of the draws of demonstrations.
        demonstrations: for the imitation loss; None for none.
        value_only: whether only the value network learns.

    Raises:
        InputError: the policy or the value network diverges.
    """
    parameters = [*policy.parameters(), *value.parameters()]
    size = min(config.batch, len(batch.raw))
    figures = []
    for _ in range(config.epochs):
        order = torch.randperm(len(batch.raw), generator=generator)
        divergences = []
        for chosen in order[: len(order) // size * size].split(size):
            log_ratio = policy.log_probability(batch.observation[chosen], batch.raw[chosen])
            log_ratio = log_ratio - batch.log_probability[chosen]
            ratio = torch.exp(log_ratio)
            advantage = batch.advantage[chosen]
            kept = torch.clamp(ratio, 1.0 - config.clip, 1.0 + config.clip)
            policy_loss = -torch.minimum(ratio * advantage, kept * advantage).mean()
            value_loss = ((value(batch.observation[chosen])[:, 0] - batch.target[chosen]) ** 2).mean()
            loss = config.vf_coef * value_loss
            if not value_only:
                loss = loss + policy_loss - config.ent_coef * policy.entropy()
            if demonstrations is not None and not value_only:
                shown = demonstrations.draw(config.batch, generator)
                loss = loss + config.imitation_weight * demonstrations.error(policy, shown)
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, config.max_grad_norm)
            optimiser.step()
            with torch.no_grad():
                divergence = float((ratio - 1.0 - log_ratio).mean())
                clipped = float((torch.abs(ratio - 1.0) > config.clip).float().mean())
            divergences.append(divergence)
            figures.append((float(value_loss.detach()), divergence, clipped))
        if np.mean(divergences) > config.target_kl:
            break
    for network in (policy, value):
        refuse_divergence(network, "ppo.learning_rate", config.learning_rate)
    return dict(zip(("value_loss", "divergence", "clipped"), np.mean(figures, axis=0).tolist(), strict=True))


def refuse_divergence(network: nn.Module, field: str, learning_rate: float) -> None:
    """Check the weights of `network` after steps of an optimiser: a training that diverges ends with a message.

    Raises:
        InputError: a weight exceeds WEIGHT_MAX or is undefined; the message names `field`, in which the configuration
            gives the `learning_rate`.
    """
    if not all(bool((weights.abs() <= WEIGHT_MAX).all()) for weights in network.parameters()):
        raise InputError(
            f"training configuration: field {field} is {learning_rate:g}, with which weights exceed {WEIGHT_MAX:g}; "
            "expected a smaller one"
        )


def tensor(values: np.ndarray | BoolArray) -> Tensor:
    """`values` as a float32 tensor of the same shape."""
    return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32)
