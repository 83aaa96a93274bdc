"""The critic: a classifier of recorded drivers against the policy, which rewards the policy for driving like them.

As in GAIL (Ho 2016), its pairs are the states and actions of drivers, and those of the policy's own episodes, so that
it judges where actions lead, too. What would give the policy away without saying anything about driving is hidden:

- what is not of the same distribution on both sides: the task (goal, due time, opponent), since recordings tell no
  intentions; and the vehicle's present acceleration, which jitters with the policy's exploration;
- exploration: drivers' actions get noise as the policy's.

Episodes behind deviating egos lead to situations that are rare in recordings, so the critic learns from those with egos
as recorded, where there are any (`environment.recorded`); it judges all.

The policy's actions are what it draws, before the bounds on jerk: within these, the acceleration after a step of 0.1 s
is close to the one before, and says next to nothing about the driver.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from litsim_policy.driving.action import ACTIONS, consistent, executed_yaw_rate, normalised, physical
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.features.scales import SPEED
from litsim_policy.driving.features.way import TASK
from litsim_research.policies.network import BOUND_MAX, multilayer
from litsim_research.policies.ppo import BatchSize, Demonstrations, Track, refuse_divergence, tensor
from litsim_sim.core.quantities import NonNegative, Number, Positive, Whole, configuration
from litsim_sim.core.scene import FloatArray

OWN_ACCELERATION = 3  # its position in an observation


@configuration
class CriticConfig:
    """How the critic learns.

    Attributes:
        learning_rate: of Adam.
        gradient_penalty: weight of the penalty on gradients with a norm above 1, between expert and policy. Norms below
            1 are not penalised, unlike in Gulrajani 2017: that would make the critic steep where both kinds are alike,
            and reward the policy for the situation it is in.
        updates: steps of the optimiser per iteration.
        batch: pairs of each kind in a step.
        noise: standard deviation of noise on all inputs, which hides the jitter of recorded accelerations from the
            critic.
        reward_limit: the reward is clipped to +- this.
    """

    learning_rate: Positive[Number] = 3e-4
    gradient_penalty: NonNegative[Number] = 2.0
    updates: Positive[Whole] = 20
    batch: BatchSize = 256
    noise: NonNegative[Number] = 0.1
    reward_limit: Positive[Number] = 3.0


class Critic(nn.Module):
    """A network from observation and action to a logit, positive for a pair that it takes for a recorded driver's."""

    def __init__(self, observations: int) -> None:
        super().__init__()
        self.body = multilayer(observations + len(ACTIONS), 1)

    def forward(self, pairs: Tensor) -> Tensor:
        """Logits (m,) of observations and actions side by side (m, observations + 3)."""
        logits: Tensor = self.body(pairs)[:, 0]
        return logits

    def reward(self, pairs: Tensor, limit: float) -> Tensor:
        """Reward (m,): log D - log(1 - D), which is the logit itself, clipped to +-`limit`.

        It has both signs: an always positive reward would favour long episodes, an always negative one short episodes,
        however the policy drives (Kostrikov 2019).
        """
        with torch.no_grad():
            return torch.clamp(self(pairs), -limit, limit)


def update_critic(
    critic: Critic,
    optimiser: torch.optim.Optimizer,
    expert: Tensor,
    policy: Tensor,
    config: CriticConfig,
    generator: torch.Generator,
) -> dict[str, float]:
    """Take `config.updates` steps of logistic regression with gradient penalty.

    Returns means over the steps: `critic_accuracy`, the share of pairs that are classified correctly, and
    `critic_loss`, including the gradient penalty.

    Args:
        critic: to train.
        optimiser: of its parameters.
        expert, policy: pairs (m, observations + 3) of recorded drivers and of the policy.
        config: of the update.
        generator: of the draws.

    Raises:
        InputError: the critic diverges.
    """
    entropy = nn.functional.binary_cross_entropy_with_logits
    losses, right = 0.0, 0.0
    for _ in range(config.updates):
        chosen = (pairs[torch.randint(len(pairs), (config.batch,), generator=generator)] for pairs in (expert, policy))
        real, made = (pairs + config.noise * torch.randn(pairs.shape, generator=generator) for pairs in chosen)
        real_logits, made_logits = critic(real), critic(made)
        loss = entropy(real_logits, torch.ones_like(real_logits)) + entropy(made_logits, torch.zeros_like(made_logits))
        excess = torch.relu(gradient_norm(critic, real, made, generator) - 1.0)
        loss = loss + config.gradient_penalty * (excess**2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses += float(loss.detach())
        right += 0.5 * float((real_logits > 0).float().mean() + (made_logits <= 0).float().mean())
    refuse_divergence(critic, "critic.learning_rate", config.learning_rate)
    return {"critic_accuracy": right / config.updates, "critic_loss": losses / config.updates}


def gradient_norm(critic: Callable[[Tensor], Tensor], real: Tensor, made: Tensor, generator: torch.Generator) -> Tensor:
    """Norms (m,) of the critic's gradient at random points between expert and policy pairs (m, inputs)."""
    share = torch.rand((len(real), 1), generator=generator)
    between = (share * real + (1.0 - share) * made).detach().requires_grad_()
    (slope,) = torch.autograd.grad(critic(between).sum(), between, create_graph=True)
    norm: Tensor = slope.norm(dim=1)
    return norm


def expert_pairs_of(
    recorded: Demonstrations, count: int, std: Tensor, config: ObservationConfig, generator: torch.Generator
) -> Tensor:
    """Draw `count` of the `recorded` pairs; their actions get noise as the policy's, of deviations `std` (3,).

    Returns:
        observations and actions side by side (count, size + 3), as the critic sees them.
    """
    chosen = recorded.draw(count, generator)
    raw = torch.atanh(torch.clamp(recorded.action[chosen], -BOUND_MAX, BOUND_MAX))
    noisy = torch.tanh(raw + std.detach() * torch.randn(raw.shape, generator=generator))
    return _pairs(recorded.observation[chosen].numpy(), noisy.double().numpy(), config)


def driven_pairs(tracks: list[Track], config: ObservationConfig) -> Tensor:
    """Observations and drawn actions side by side (m, size + 3) of all agent-steps, as the critic sees them.

    Steps with a contact or off the road are included; the observation after the last step of a track is not.
    """
    observation = np.concatenate([track.observation[:-1] for track in tracks])
    return _pairs(observation, np.tanh(np.concatenate([track.raw for track in tracks])), config)


def _pairs(observation: FloatArray, action: FloatArray, config: ObservationConfig) -> Tensor:
    """Both side by side (m, size + 3), with what is hidden at 0, and one turn in place of the two lateral actions."""
    speed, wanted = observation[:, 2] * SPEED, physical(action)
    made = normalised(consistent(wanted[:, 0], executed_yaw_rate(wanted, speed), speed))
    seen = observation.copy()
    seen[:, [OWN_ACCELERATION, *range(config.size - TASK, config.size)]] = 0.0
    return tensor(np.concatenate([seen, made], axis=1))
