"""Behaviour cloning, the warm start of a policy."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from litsim_research.policies.network import StochasticPolicy
from litsim_research.policies.ppo import BatchSize, Demonstrations, refuse_divergence
from litsim_sim.core.quantities import NonNegative, Number, Positive, Whole, configuration


@configuration
class WarmStart:
    """Behaviour cloning before the first iteration; 0 epochs for none."""

    epochs: NonNegative[Whole] = 30
    batch: BatchSize = 256
    learning_rate: Positive[Number] = 1e-3


def clone(
    policy: StochasticPolicy,
    shown: Demonstrations,
    config: WarmStart,
    seed: int,
    loss_of: Callable[[StochasticPolicy, Tensor], Tensor],
) -> None:
    """Fit `policy` to the pairs in `shown`, in place.

    Args:
        policy: to train.
        shown: the pairs.
        config: epochs, batch and learning rate.
        seed: of the draws of pairs.
        loss_of: mean loss of a policy over the pairs at positions (m,) of `shown`.

    Raises:
        InputError: the policy diverges.
    """
    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(policy.parameters(), config.learning_rate)
    for _ in range(config.epochs):
        for chosen in shown.draw(len(shown.action), generator).split(config.batch):
            loss = loss_of(policy, chosen)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    refuse_divergence(policy, "warm_start.learning_rate", config.learning_rate)
