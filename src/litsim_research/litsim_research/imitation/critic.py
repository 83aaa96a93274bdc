"""The critic of GAIL: a Wasserstein critic with gradient penalty (Gulrajani 2017), as in PS-GAIL for driving."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from litsim_research.policies.critic import gradient_norm
from litsim_research.policies.ppo import BatchSize, Demonstrations, refuse_divergence
from litsim_sim.core.quantities import NonNegative, Number, OpenShare, Positive, Whole, configuration


@configuration
class WassersteinConfig:
    """How the critic learns; the published training makes 40 passes over batches of 1000.

    Attributes:
        learning_rate: of RMSProp.
        gradient_penalty: weight.
        dropout: probability with which a unit is dropped.
        updates: steps of the optimiser per iteration.
        batch: pairs of each side in a step.
        replay: number of last iterations from which the policy's pairs are drawn.
    """

    learning_rate: Positive[Number] = 4e-4
    gradient_penalty: NonNegative[Number] = 2.0
    dropout: OpenShare = 0.2
    updates: Positive[Whole] = 80
    batch: BatchSize = 1000
    replay: Positive[Whole] = 3


def update_wasserstein(
    critic: nn.Module,
    optimiser: torch.optim.Optimizer,
    recorded: Demonstrations,
    driven: Tensor,
    config: WassersteinConfig,
    generator: torch.Generator,
) -> float:
    """Take `config.updates` steps, and return the mean difference of the critic between drivers and policy.

    Args:
        critic: to train; maps observations and actions side by side (m, size + 2) to (m, 1).
        optimiser: of its parameters.
        recorded: pairs of drivers.
        driven: (m, size + 2) pairs of the policy.
        config: of the update.
        generator: of the draws; it also seeds torch's own generator, from which dropout draws.

    Raises:
        InputError: the critic diverges.
    """
    torch.manual_seed(int(torch.randint(2**31, (), generator=generator)))
    critic.train()
    apart = 0.0
    for _ in range(config.updates):
        chosen = recorded.draw(config.batch, generator)
        real = torch.cat([recorded.observation[chosen], recorded.action[chosen]], dim=1)
        generated = driven[torch.randint(len(driven), (config.batch,), generator=generator)]
        distance = critic(real).mean() - critic(generated).mean()
        penalty = ((gradient_norm(critic, real, generated, generator) - 1.0) ** 2).mean()
        optimiser.zero_grad()
        (config.gradient_penalty * penalty - distance).backward()
        optimiser.step()
        apart += float(distance.detach())
    critic.eval()
    refuse_divergence(critic, "critic.learning_rate", config.learning_rate)
    return apart / config.updates
