"""PPO and the critic: advantages by definition, updates that go the right way."""

import numpy as np
import pytest
import torch

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_research.policies.critic import Critic, CriticConfig, update_critic
from litsim_research.policies.network import GaussianPolicy, multilayer, pedal_bounds
from litsim_research.policies.ppo import (
    Batch,
    Demonstrations,
    PpoConfig,
    Track,
    advantages,
    make_batch,
    update_policy,
)

CONFIG = PpoConfig(discount=0.9, gae_lambda=0.8)
SEEN = ObservationConfig(slots=2)


def by_definition(reward: np.ndarray, value: np.ndarray, *, terminated: bool) -> list[float]:
    """The sum over all later surprises, written out."""
    following = np.append(value[1:-1], 0.0 if terminated else value[-1])
    surprise = reward + CONFIG.discount * following - value[:-1]
    factor = CONFIG.discount * CONFIG.gae_lambda
    return [float((surprise[t:] * factor ** np.arange(len(reward) - t)).sum()) for t in range(len(reward))]


@pytest.mark.parametrize("terminated", [True, False])
def test_advantages(*, terminated: bool) -> None:
    random = np.random.default_rng(0)
    reward, value = random.normal(size=6), random.normal(size=7)
    found, target = advantages(reward, value, CONFIG, terminated=terminated)
    assert found == pytest.approx(by_definition(reward, value, terminated=terminated))
    assert target == pytest.approx(found + value[:-1])


def reach(observation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest acceleration, as actions (m,) each, that the bounds on jerk let through."""
    low, high = pedal_bounds(observation)
    return np.tanh(low), np.tanh(high)


def tracks(policy: GaussianPolicy, seed: int = 0, count: int = 8, steps: int = 32) -> list[Track]:
    """Driven by `policy` through observations that do not depend on what it does."""
    generator = torch.Generator().manual_seed(seed)
    random = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        observation = random.uniform(-1.0, 1.0, (steps + 1, SEEN.size))
        seen = torch.as_tensor(observation[:-1], dtype=torch.float32)
        raw = policy.draw(seen, generator)
        density = policy.log_probability(seen, raw).detach()
        executed = torch.tanh(raw).double().numpy()
        executed[:, 0] = np.clip(executed[:, 0], *reach(observation[:-1]))
        made.append(Track(observation, raw.numpy(), density.numpy(), executed, np.zeros(steps), terminated=False))
    return made


def test_the_policy_goes_where_the_reward_is() -> None:
    torch.manual_seed(0)
    policy, value = GaussianPolicy(SEEN), multilayer(SEEN.size, 1)
    optimiser = torch.optim.Adam([*policy.parameters(), *value.parameters()], 3e-3)
    config = PpoConfig(batch=64, epochs=4, target_kl=0.05, discount=0.5)
    generator = torch.Generator().manual_seed(1)
    start = None
    for seed in range(20):
        driven = tracks(policy, seed)
        nearest = [np.clip(0.5, *reach(track.observation[:-1])) for track in driven]
        rewards = [-((track.executed[:, 0] - best) ** 2) for track, best in zip(driven, nearest, strict=True)]
        start = start if start is not None else np.mean(rewards)
        step = update_policy(policy, value, optimiser, make_batch(driven, rewards, value, config), config, generator)
        assert np.isfinite(list(step.values())).all()
    assert np.mean(rewards) > 0.5 * start  # rewards are negative
    assert np.mean([np.tanh(track.raw[:, 0]).mean() for track in driven]) > 0.3


def test_passes_end_when_the_policy_has_moved() -> None:
    torch.manual_seed(0)
    policy, value = GaussianPolicy(SEEN), multilayer(SEEN.size, 1)
    driven = tracks(policy)
    batch = make_batch(driven, [track.executed[:, 0] for track in driven], value, CONFIG)
    before = policy.mean.weight.detach().clone()

    def moved(config: PpoConfig) -> float:
        with torch.no_grad():
            policy.mean.weight.copy_(before)
        optimiser = torch.optim.SGD([*policy.parameters(), *value.parameters()], 0.3)
        update_policy(policy, value, optimiser, batch, config, torch.Generator().manual_seed(0))
        return float((policy.mean.weight.detach() - before).norm())

    assert moved(PpoConfig(epochs=10, target_kl=-1.0)) < 0.7 * moved(PpoConfig(epochs=10, target_kl=9.0))


def test_the_value_can_learn_alone_and_drivers_can_hold_the_policy_back() -> None:
    torch.manual_seed(0)
    policy, value = GaussianPolicy(SEEN), multilayer(SEEN.size, 1)
    driven = tracks(policy)
    batch = make_batch(driven, [track.executed[:, 0] for track in driven], value, CONFIG)
    optimiser = torch.optim.Adam([*policy.parameters(), *value.parameters()], 3e-3)
    before = [part.detach().clone() for part in policy.parameters()], value[0].weight.detach().clone()
    generator = torch.Generator().manual_seed(0)
    update_policy(policy, value, optimiser, batch, CONFIG, generator, value_only=True)
    assert all(torch.equal(a, b) for a, b in zip(policy.parameters(), before[0], strict=True))
    assert not torch.equal(value[0].weight, before[1])

    action = torch.tensor([[-0.6, 0.1, 0.1], [-0.4, -0.1, -0.1]]).repeat(64, 1)
    shown = Demonstrations(batch.observation[:128], action, torch.ones(128))
    config = PpoConfig(batch=64, epochs=60, target_kl=1e9, imitation_weight=100.0)
    update_policy(policy, value, optimiser, batch, config, generator, shown)
    assert float(torch.tanh(policy(batch.observation[:128])).detach()[:, 0].mean()) == pytest.approx(-0.5, abs=0.1)


def test_a_batch_is_normalised() -> None:
    policy, value = GaussianPolicy(SEEN), multilayer(SEEN.size, 1)
    driven = tracks(policy)
    batch = make_batch(driven, [7.0 + track.executed[:, 0] for track in driven], value, CONFIG)
    assert isinstance(batch, Batch) and len(batch.raw) == 8 * 32
    assert float(batch.advantage.mean()) == pytest.approx(0.0, abs=1e-5)
    assert float(batch.advantage.std()) == pytest.approx(1.0, abs=0.01)


# The critic


def test_the_critic_tells_sides_apart() -> None:
    torch.manual_seed(0)
    critic = Critic(5)
    generator = torch.Generator().manual_seed(0)
    expert = torch.randn((500, 8), generator=generator) + 1.0
    made = torch.randn((500, 8), generator=generator) - 1.0
    optimiser = torch.optim.Adam(critic.parameters(), 1e-3)
    config = CriticConfig(updates=60, batch=64)
    first = update_critic(critic, optimiser, expert, made, CriticConfig(updates=1, batch=64), generator)
    for _ in range(3):
        step = update_critic(critic, optimiser, expert, made, config, generator)
    assert step["critic_loss"] < first["critic_loss"] and step["critic_accuracy"] > 0.9
    human, machine = critic.reward(expert, 3.0), critic.reward(made, 3.0)
    assert float(human.mean()) > 0.0 > float(machine.mean())
    assert float(torch.abs(human).max()) <= 3.0
