"""The critic's sides: it tells them by how is driven, not by what only one of them can have."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from litsim_policy.driving.action import executed_yaw_rate, physical
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.features.scales import SPEED
from litsim_research.policies.critic import (
    OWN_ACCELERATION,
    Critic,
    CriticConfig,
    driven_pairs,
    expert_pairs_of,
    update_critic,
)
from litsim_research.policies.episodes import Course, EnvironmentConfig, Episodes
from litsim_research.policies.expert import ExpertConfig, ExpertPairs, expert_pairs, share_weights
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.ppo import Track, tensor
from litsim_research.policies.task import TaskConfig
from litsim_sim.scenario.scenario import Scenario

SEEN = ObservationConfig()
SIZE = SEEN.size
WAY = slice(SIZE - 6, SIZE)
"""Features that tell of the task: distance to the goal, time to it, and the opponent."""


@pytest.fixture(scope="module")
def scenario(make_scenario: Any, track: Any, lane_centres: tuple[float, ...]) -> Scenario:
    """Eighteen vehicles on three lanes, at speeds of their own; any may be the ego."""
    random = np.random.default_rng(0)
    tracks = [
        track(
            1 + 6 * lane + k,
            x=40.0 + 25.0 * k + random.uniform(-5.0, 5.0),
            y=lane_centres[lane + 1],
            speed=8.0 + lane + random.uniform(-1.0, 1.0),
            acceleration=random.uniform(-0.1, 0.1),
            last=90,
        )
        for lane in range(3)
        for k in range(6)
    ]
    return make_scenario(*tracks, egos=list(range(1, 19)))


@pytest.fixture(scope="module")
def experts(scenario: Scenario) -> ExpertPairs:
    return expert_pairs([scenario], SEEN, ExpertConfig(every=2), TaskConfig(), np.random.default_rng(1))


def accuracy(expert: Tensor, policy: Tensor) -> float:
    """Of a critic that has learned from 7 of 10 pairs of each side, on those that were held out."""
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    critic = Critic(expert.shape[1] - 3)
    optimiser = torch.optim.Adam(critic.parameters(), 1e-3)
    sides = [side[torch.randperm(len(side), generator=generator)] for side in (expert, policy)]
    (taught, expert_left), (shown, policy_left) = (side.split(len(side) * 7 // 10)[:2] for side in sides)
    update_critic(critic, optimiser, taught, shown, CriticConfig(updates=300, gradient_penalty=0.1), generator)
    with torch.no_grad():
        return 0.5 * float((critic(expert_left) > 0).float().mean() + (critic(policy_left) <= 0).float().mean())


def test_the_critic_tells_the_sides_by_actions_and_not_by_exploration(experts: ExpertPairs) -> None:
    """Drivers' actions with the policy's noise: a policy that does as they do passes, one that accelerates does not."""
    recorded, _ = experts.demonstrations(0.5)
    std = GaussianPolicy(SEEN).std()

    def drawn(seed: int) -> Tensor:
        return expert_pairs_of(recorded, 2000, std, SEEN, torch.Generator().manual_seed(seed))

    expert, again, faster = drawn(0), drawn(1), drawn(2)
    faster[:, -3] += 0.4
    assert not torch.equal(expert, again)
    assert accuracy(expert, again) < 0.6
    assert accuracy(expert, faster) > 0.7
    noise = float((expert[:, -3] - expert[:, -3].mean()).std())
    assert noise > 3.0 * float(recorded.action[:, 0].std()), "the noise hides what is not the driver's"


def test_the_critic_judges_where_actions_lead(experts: ExpertPairs) -> None:
    """Who does the same, but 5 m/s faster, is told by the state."""
    recorded, _ = experts.demonstrations(0.5)
    expert, other = (
        expert_pairs_of(recorded, 2000, torch.full((3,), 0.3), SEEN, torch.Generator().manual_seed(k)) for k in (0, 1)
    )
    other[:, 2] += 5.0 / SPEED
    assert accuracy(expert, other) > 0.8


def test_tasks_and_jitter_are_hidden_from_the_critic(experts: ExpertPairs) -> None:
    recorded, _ = experts.demonstrations(0.5)
    pairs = expert_pairs_of(recorded, 100, torch.full((3,), 0.3), SEEN, torch.Generator().manual_seed(0))
    assert not pairs[:, WAY].any() and not pairs[:, OWN_ACCELERATION].any()
    assert pairs[:, 2].any() and pairs[:, SIZE - 7].shape == (100,)


def test_sampled_agents_are_not_known_by_their_tasks(scenario: Scenario, experts: ExpertPairs) -> None:
    """What tells of the task looks alike in recordings, where the critic learns, and in episodes, where it rewards."""
    course = Course([scenario], EnvironmentConfig(sampled=10, slots=10))
    episodes = Episodes(course, [course.start(np.random.default_rng(seed)) for seed in range(60)])
    driven = tensor(episodes.seen[:, WAY])
    recorded = tensor(experts.observation[:, WAY])
    assert len(driven) > 300
    told = {
        name: accuracy(*(torch.cat([s[:, c], torch.zeros(len(s), 3)], dim=1) for s in (recorded, driven)))
        for name, c in {"goal": slice(0, 2), "opponent": slice(2, 3)}.items()
    }
    assert max(told.values()) < 0.6, told


def test_people_count_as_much_as_they_are_said_to() -> None:
    real = np.arange(100) < 4
    size = np.zeros((100, SIZE))
    experts = ExpertPairs(size, np.column_stack([real, real, real]) * 0.5, size, size[:, :3], real)
    for share in (0.0, 0.3, 1.0):
        recorded, shown = experts.demonstrations(share)
        drawn = recorded.draw(4000, torch.Generator().manual_seed(0))
        assert float((recorded.action[drawn, 0] > 0).float().mean()) == pytest.approx(share, abs=0.03)
        both = shown.draw(4000, torch.Generator().manual_seed(0))
        assert float((both >= 100).float().mean()) == pytest.approx(0.5, abs=0.04), "corrections as often as drivers"
    none = np.zeros(100, np.bool_)
    assert share_weights(none, 0.9) == pytest.approx(np.full(100, 0.01)), (
        "where there are no people, the others are all"
    )


def test_the_critic_sees_what_was_drawn_as_the_one_turn_that_a_vehicle_makes_of_it() -> None:
    observation = np.zeros((3, SIZE))
    observation[:, 2] = 12.0 / SPEED
    raw = np.array([[0.4, -0.3, 0.2], [-0.5, 0.1, 0.1]])
    track = Track(observation, raw, np.zeros(2), np.zeros((2, 3)), np.zeros(2), terminated=False)
    pairs = driven_pairs([track], SEEN).numpy()
    assert pairs.shape == (2, SIZE + 3)
    done, turn = physical(pairs[:, -3:].astype(np.float64)), executed_yaw_rate(physical(np.tanh(raw)), np.full(2, 12.0))
    assert done[:, 0] == pytest.approx(physical(np.tanh(raw))[:, 0], abs=1e-5)
    assert done[:, 2] == pytest.approx(turn, abs=1e-5) and done[:, 1] == pytest.approx(12.0 * turn, abs=1e-4)
