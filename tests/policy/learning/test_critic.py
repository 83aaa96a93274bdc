"""The critic's regularisers: the gradient penalty and the noise, and that both are part of what it learns by."""

from __future__ import annotations

import pytest
import torch

from litsim_policy.learning.critic import Critic, CriticConfig, gradient_penalty, update_critic


class Bowl(torch.nn.Module):
    """Half the weighted square of its input: the gradient there is the weight times the input."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.tensor(1.0))

    def forward(self, pairs: torch.Tensor) -> torch.Tensor:
        return 0.5 * self.weight * (pairs**2).sum(dim=1, keepdim=True)


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_the_penalty_is_taken_all_along_the_way_between_both_sides() -> None:
    """From 0 to 2 on one axis the gradient norm grows from 0 to 2, and is 1/3 off 1 in the mean square."""
    critic = Critic(2)
    critic.body = Bowl()
    real, made = torch.zeros((20_000, 5)), torch.zeros((20_000, 5))
    made[:, 0] = 2.0
    for sides in ((real, made), (made, real)):
        assert float(gradient_penalty(critic, *sides, seeded()).detach()) == pytest.approx(1.0 / 3.0, abs=0.02)


def test_the_penalty_teaches_the_weights() -> None:
    critic = Critic(2)
    bowl = critic.body = Bowl()
    gradient_penalty(critic, torch.full((64, 5), 3.0), torch.full((64, 5), 3.0), seeded()).backward()
    # the norm is n = 3 sqrt(5) times the weight, which is 1: d/dw (n w - 1)^2 = 2 n (n - 1)
    norm = 3.0 * 5.0**0.5
    assert bowl.weight.grad is not None
    assert float(bowl.weight.grad) == pytest.approx(2.0 * norm * (norm - 1.0), rel=1e-4)


def test_the_penalty_keeps_the_slope_near_one() -> None:
    def slope(weight: float) -> float:
        torch.manual_seed(0)
        critic, generator = Critic(5), seeded()
        expert = 0.1 * torch.randn((400, 8), generator=generator) + 0.2
        made = 0.1 * torch.randn((400, 8), generator=generator) - 0.2
        optimiser = torch.optim.Adam(critic.parameters(), 3e-3)
        config = CriticConfig(updates=200, batch=64, gradient_penalty=weight, noise=0.0)
        update_critic(critic, optimiser, expert, made, config, generator)
        between = (0.5 * (expert + made)).requires_grad_()
        (found,) = torch.autograd.grad(critic(between).sum(), between)
        return float(found.norm(dim=1).mean())

    assert slope(50.0) == pytest.approx(1.0, abs=0.2)
    assert slope(0.0) > 2.0


def test_noise_hides_what_only_jitter_tells_apart() -> None:
    def accuracy(noise: float) -> float:
        torch.manual_seed(0)
        critic, generator = Critic(5), seeded()
        expert, made = torch.full((400, 8), 0.05), torch.full((400, 8), -0.05)
        optimiser = torch.optim.Adam(critic.parameters(), 3e-3)
        config = CriticConfig(updates=200, batch=64, gradient_penalty=0.0, noise=noise)
        return update_critic(critic, optimiser, expert, made, config, generator).accuracy

    assert accuracy(0.0) > 0.95
    assert accuracy(2.0) < 0.65
