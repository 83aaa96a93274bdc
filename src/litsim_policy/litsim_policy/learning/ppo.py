"""Proximal policy optimisation (Schulman 2017) with generalised advantages, on the tracks of many agents."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from litsim_sim.core.quantities import NonNegative, Number, Positive, Share, Whole, configuration
from litsim_sim.core.scene import BoolArray, FloatArray


class Learner(Protocol):
    """A policy that draws actions from a density; what :func:`update_policy` improves."""

    def log_probability(self, observation: Tensor, raw: Tensor) -> Tensor:
        """Logarithm of the density (m,) of actions, given as they were drawn, at observations (m, size)."""

    def entropy(self) -> Tensor:
        """Entropy of the density, a scalar in nats."""

    def said(self, observation: Tensor) -> Tensor:
        """Actions in the middle of the density, at observations (m, size)."""

    def parameters(self) -> Iterator[nn.Parameter]:
        """What is to be learned."""


@configuration
class PpoConfig:
    """Parameters of the update; of these the paper gives a learning rate of 0.03 and batches of 32.

    Attributes:
        learning_rate: of Adam.
        batch: transitions in a step of the optimiser.
        epochs: passes over the transitions of an iteration.
        clip: of the probability ratio.
        discount: per step of 0.1 s.
        smoothing: lambda of the advantages.
        value_weight, entropy_weight: in the loss.
        gradient_limit: norm to which gradients are cut.
        divergence_limit: mean Kullback-Leibler divergence from the policy that drove at which the passes end.
        imitation_weight: of the squared error against drivers' actions, in units of their spread: keeps the policy near
            what drivers do while it learns to avoid collisions (BC with RL, as Lu 2023 found needed for both).
        correction_weight: of the squared error, on the same steps, against what guards would have done where they would
            have changed the command: a penalty tells that something was wrong, this tells what was right (as DAgger,
            Ross 2011, has an expert say what to do where the learner gets to).
        value_first: iterations in which only the value learns; advantages by a value that knows nothing are noise.
    """

    learning_rate: Positive[Number] = 3e-4
    batch: Positive[Whole] = 256
    epochs: Positive[Whole] = 4
    clip: Positive[Number] = 0.2
    discount: Share = 0.98
    smoothing: Share = 0.95
    value_weight: NonNegative[Number] = 0.5
    entropy_weight: NonNegative[Number] = 0.001
    gradient_limit: Positive[Number] = 0.5
    divergence_limit: Number = 0.01
    imitation_weight: NonNegative[Number] = 0.3
    correction_weight: NonNegative[Number] = 0.0
    value_first: NonNegative[Whole] = 3


@dataclass(frozen=True)
class Track:
    """What one agent went through while it was under the policy; T steps.

    Attributes:
        observation: (T + 1, size), the last one after the last step.
        raw: (T, 3) actions before tanh.
        log_probability: (T,) logarithm of the density with which the policy drew them, after tanh.
        executed: (T, 3) what the vehicle did of it, as actions in [-1, 1].
        penalty: (T,) of the augmented reward, at most 0.
        terminated: whether it ended in a collision or off the road; otherwise the agent went on in other hands, or the
            time was up.
        corrected: (T, 3) what should have been done instead, as actions in [-1, 1], not a number where nothing should;
            None where nobody says.
    """

    observation: FloatArray
    raw: FloatArray
    log_probability: FloatArray
    executed: FloatArray
    penalty: FloatArray
    terminated: bool
    corrected: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.raw)


@dataclass(frozen=True)
class Batch:
    """The m agent-steps of an iteration, of all tracks one after another.

    Attributes:
        observation: (m, size) before the step.
        raw: (m, 3) actions before tanh.
        log_probability: (m,) of them, by the policy that drove.
        advantage: (m,) of mean 0 and standard deviation 1.
        target: (m,) that the value is to learn.
        corrected: (m, 3) as in :class:`Track`; None where nobody says.
    """

    observation: Tensor
    raw: Tensor
    log_probability: Tensor
    advantage: Tensor
    target: Tensor
    corrected: Tensor | None = None


@dataclass(frozen=True)
class Demonstrations:
    """What drivers did; the policy's mean is kept near it.

    Attributes:
        observation: (n, size).
        action: (n, 3) in [-1, 1].
        weight: (n,) of the pairs when they are drawn, of any sum; None where all count alike.
    """

    observation: Tensor
    action: Tensor
    weight: Tensor | None = None

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """(count,) positions of pairs, drawn by their weights and with replacement."""
        if self.weight is None:
            return torch.randint(len(self.action), (count,), generator=generator)
        until = self._until
        return torch.searchsorted(
            until, until[-1] * torch.rand(count, generator=generator, dtype=torch.float64), right=True
        )

    @cached_property
    def _until(self) -> Tensor:
        """(n,) sums of the weights up to each pair."""
        assert self.weight is not None
        return torch.cumsum(self.weight.double(), 0)

    def error(self, policy: Learner, chosen: Tensor) -> Tensor:
        """Mean squared error on the pairs `chosen` (m,), each action in units of its spread; a scalar."""
        said = policy.said(self.observation[chosen])
        return nn.functional.mse_loss(said / self._scale, self.action[chosen] / self._scale)

    @cached_property
    def _scale(self) -> Tensor:
        """(3,) spread of each action, a little above 0."""
        return self.action.std(dim=0) + 1e-3


@dataclass(frozen=True)
class PpoStep:
    """Means over the minibatches of an update.

    Attributes:
        policy_loss: clipped surrogate, negated.
        value_loss: squared error of the value.
        divergence: Kullback-Leibler divergence from the policy that drove.
        clipped: share of agent-steps whose probability ratio was clipped.
    """

    policy_loss: float
    value_loss: float
    divergence: float
    clipped: float


def advantages(
    reward: FloatArray, value: FloatArray, config: PpoConfig, *, terminated: bool
) -> tuple[FloatArray, FloatArray]:
    """Generalised advantages (T,) and value targets (T,) of one track.

    Args:
        reward: (T,).
        value: (T + 1,) of the observations.
        config: discount and smoothing.
        terminated: nothing comes after the last step; otherwise its successor's value does (time limits, hand-back).
    """
    following = value[1:].copy()
    if terminated:
        following[-1] = 0.0
    surprise = reward + config.discount * following - value[:-1]
    found = np.zeros(len(reward))
    carried = 0.0
    for t in range(len(reward) - 1, -1, -1):
        carried = surprise[t] + config.discount * config.smoothing * carried
        found[t] = carried
    return found, found + value[:-1]


def make_batch(tracks: list[Track], rewards: list[FloatArray], value: nn.Module, config: PpoConfig) -> Batch:
    """The agent-steps of all `tracks`, with advantages that have mean 0 and standard deviation 1 over all of them.

    Args:
        tracks: what the policy drove.
        rewards: (T,) of each track.
        value: network of the value of observations.
        config: discount and smoothing.
    """
    found = []
    with torch.no_grad():
        for track, reward in zip(tracks, rewards, strict=True):
            values = value(tensor(track.observation))[:, 0].double().numpy()
            found.append(advantages(reward, values, config, terminated=track.terminated))
    corrected = [track.corrected for track in tracks if track.corrected is not None]
    advantage = np.concatenate([a for a, _ in found])
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    return Batch(
        tensor(np.concatenate([track.observation[:-1] for track in tracks])),
        tensor(np.concatenate([track.raw for track in tracks])),
        tensor(np.concatenate([track.log_probability for track in tracks])),
        tensor(advantage),
        tensor(np.concatenate([target for _, target in found])),
        tensor(np.concatenate(corrected)) if corrected else None,
    )


def update_policy(
    policy: Learner,
    value: nn.Module,
    optimiser: torch.optim.Optimizer,
    batch: Batch,
    config: PpoConfig,
    generator: torch.Generator,
    demonstrations: Demonstrations | None = None,
    *,
    value_only: bool = False,
) -> PpoStep:
    """Make passes over `batch` in random order and in whole minibatches (the rest of a pass is left out).

    Args:
        policy, value: to update.
        optimiser: of the parameters of both.
        batch: what the policy drove.
        config: of the update.
        generator: of the order.
        demonstrations: what the policy is kept near.
        value_only: leave the policy as it is.
    """
    parameters = [*policy.parameters(), *value.parameters()]
    size = min(config.batch, len(batch.raw))
    seen = []
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
            loss = config.value_weight * value_loss
            if not value_only:
                loss = loss + policy_loss - config.entropy_weight * policy.entropy()
            if demonstrations is not None and not value_only:
                shown = demonstrations.draw(config.batch, generator)
                loss = loss + config.imitation_weight * demonstrations.error(policy, shown)
            if batch.corrected is not None and config.correction_weight and not value_only:
                error = correction_error(policy, batch.observation[chosen], batch.corrected[chosen])
                loss = loss + config.correction_weight * error
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, config.gradient_limit)
            optimiser.step()
            with torch.no_grad():
                divergence = float((ratio - 1.0 - log_ratio).mean())
                clipped = float((torch.abs(ratio - 1.0) > config.clip).float().mean())
            divergences.append(divergence)
            seen.append((float(policy_loss.detach()), float(value_loss.detach()), divergence, clipped))
        if np.mean(divergences) > config.divergence_limit:
            break
    return PpoStep(*np.mean(seen, axis=0).tolist())


CORRECTION_SCALE = (0.3, 0.2, 0.2)  # of actions: an error of this much counts 1


def correction_error(policy: Learner, observation: Tensor, corrected: Tensor) -> Tensor:
    """Squared error of the means against corrections (m, 3), a scalar: a mean over all m, 0 where there is none."""
    said = policy.said(observation)
    apart = (said - corrected) / torch.tensor(CORRECTION_SCALE)
    return torch.where(torch.isnan(corrected), torch.zeros_like(said), apart.nan_to_num() ** 2).mean()


def tensor(values: np.ndarray | BoolArray) -> Tensor:
    """`values` as a tensor of the same shape, float32, in which the networks compute."""
    return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32)
