"""The critic's regularisers: the gradient penalty and the noise, and that both are part of what it learns by."""

import pytest
import torch

from litsim_research.policies.critic import Critic, CriticConfig, gradient_norm, update_critic


class Bowl(torch.nn.Module):
    """Half the weighted square of its input: the gradient there is the weight times the input."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.tensor(1.0))

    def forward(self, pairs: torch.Tensor) -> torch.Tensor:
        return 0.5 * self.weight * (pairs**2).sum(dim=1, keepdim=True)


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def two_sided(critic: Critic, real: torch.Tensor, made: torch.Tensor) -> torch.Tensor:
    return ((gradient_norm(critic, real, made, seeded()) - 1.0) ** 2).mean()


def test_the_penalty_is_taken_all_along_the_way_between_both_sides() -> None:
    """From 0 to 2 on one axis the gradient norm grows from 0 to 2, and is 1/3 off 1 in the mean square."""
    critic = Critic(2)
    critic.body = Bowl()
    real, made = torch.zeros((20_000, 5)), torch.zeros((20_000, 5))
    made[:, 0] = 2.0
    for sides in ((real, made), (made, real)):
        assert float(two_sided(critic, *sides).detach()) == pytest.approx(1.0 / 3.0, abs=0.02)


def test_the_penalty_teaches_the_weights() -> None:
    critic = Critic(2)
    bowl = critic.body = Bowl()
    two_sided(critic, torch.full((64, 5), 3.0), torch.full((64, 5), 3.0)).backward()
    # the norm is n = 3 sqrt(5) times the weight, which is 1: d/dw (n w - 1)^2 = 2 n (n - 1)
    norm = 3.0 * 5.0**0.5
    assert bowl.weight.grad is not None
    assert float(bowl.weight.grad) == pytest.approx(2.0 * norm * (norm - 1.0), rel=1e-4)


def test_where_the_sides_are_alike_the_critic_is_flat() -> None:
    """It does not reward where the policy is when what the policy does tells nothing."""
    torch.manual_seed(0)
    critic, generator = Critic(5), seeded()
    optimiser = torch.optim.Adam(critic.parameters(), 3e-3)
    alike = torch.randn((800, 8), generator=generator)
    update_critic(critic, optimiser, alike, alike, CriticConfig(updates=300, batch=256), generator)
    with torch.no_grad():
        assert float(critic(alike).std()) < 0.3


def test_the_penalty_keeps_the_slope_from_exceeding_one() -> None:
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

    assert 0.5 < slope(50.0) < 1.2
    assert slope(0.0) > 2.0


def test_noise_hides_what_only_jitter_tells_apart() -> None:
    def accuracy(noise: float) -> float:
        torch.manual_seed(0)
        critic, generator = Critic(5), seeded()
        expert, made = torch.full((400, 8), 0.05), torch.full((400, 8), -0.05)
        optimiser = torch.optim.Adam(critic.parameters(), 3e-3)
        config = CriticConfig(updates=200, batch=64, gradient_penalty=0.0, noise=noise)
        return update_critic(critic, optimiser, expert, made, config, generator)["critic_accuracy"]

    assert accuracy(0.0) > 0.95
    assert accuracy(2.0) < 0.65
