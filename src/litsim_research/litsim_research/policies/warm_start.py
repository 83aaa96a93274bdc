"""Behaviour cloning, the warm start of a policy."""

from __future__ import annotations

from collections.abc import Callable

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from litsim_research.policies.network import StochasticPolicy
from litsim_research.policies.ppo import Demonstrations, refuse_divergence


class WarmStart(BaseModel):
    """Behaviour cloning before the first iteration; 0 epochs for none."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    epochs: int = Field(30, ge=0)
    batch: int = Field(256, gt=0)
    learning_rate: float = Field(1e-3, gt=0)


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
