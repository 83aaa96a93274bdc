"""The critic: a classifier of recorded drivers against the policy, which rewards the policy for acting like drivers.

It learns from both kinds of recorded drivers: people in NGSIM, and SUMO's models in generated segments. Its pairs are
recorded actions, and the policy's in the same situations. If the policy's pairs came from its own episodes, the critic
could tell them apart by the situation (another ego, other traffic, offsets from a path that in a recording is the
driver's own) and ignore the action. Here only the action differs; consequences of actions are left to the penalties.

The policy's actions are what it draws, before the bounds on jerk: within these, the acceleration after a step of 0.1 s
is close to the one before, and says next to nothing about the driver.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from litsim_policy.driving.action import ACTIONS, consistent, executed_yaw_rate, normalised, physical
from litsim_policy.driving.features.scales import SPEED
from litsim_research.policies.network import GaussianPolicy, multilayer
from litsim_research.policies.ppo import BatchSize, Demonstrations, Track, refuse_divergence, tensor
from litsim_sim.core.quantities import NonNegative, Number, Positive, Whole, configuration
from litsim_sim.core.scene import FloatArray


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


def expert_and_policy_pairs(
    policy: GaussianPolicy, recorded: Demonstrations, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw `count` of the `recorded` pairs, and an action of `policy` for each of their observations.

    Returns:
        observations and actions side by side, (count, size + 3) of the drivers and of the policy, in the same order.
    """
    observation = recorded.observation[chosen := recorded.draw(count, generator)]
    drawn = torch.tanh(policy.draw(observation, generator)).double().numpy()
    expert = recorded.action[chosen].double().numpy()
    return _pairs(observation.numpy(), expert), _pairs(observation.numpy(), drawn)


def driven_pairs(tracks: list[Track]) -> Tensor:
    """Observations and drawn actions side by side (m, size + 3) of all agent-steps, as the critic sees them.

    Steps with a contact or off the road are included; the observation after the last step of a track is not.
    """
    observation = np.concatenate([track.observation[:-1] for track in tracks])
    return _pairs(observation, np.tanh(np.concatenate([track.raw for track in tracks])))


def _pairs(observation: FloatArray, action: FloatArray) -> Tensor:
    """Both side by side (m, size + 3), with the two lateral actions replaced by the turn that results from them."""
    speed, wanted = observation[:, 2] * SPEED, physical(action)
    made = normalised(consistent(wanted[:, 0], executed_yaw_rate(wanted, speed), speed))
    return tensor(np.concatenate([observation, made], axis=1))
