"""Episodes: whole tracks, what is counted by episode and what by agent, and an end where nobody is driven."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from litsim_policy.learning.config import TrainConfig
from litsim_policy.learning.environment import EnvironmentConfig, PolicyEnvironment
from litsim_policy.learning.network import GaussianPolicy
from litsim_policy.learning.reward import Penalties
from litsim_policy.learning.rollout import EMPTY_EPISODES_MAX, HereDriving, collect, drive, validate
from litsim_sim.core.errors import InputError

SMALL = EnvironmentConfig(steps_max=20, slots=4, drafted=3)


@pytest.fixture(scope="module")
def config() -> TrainConfig:
    return TrainConfig(data={}, transitions=40, validation_episodes=2, environment=SMALL)


@pytest.fixture(scope="module")
def policy(config: TrainConfig) -> GaussianPolicy:
    torch.manual_seed(0)
    return GaussianPolicy(config.observation)


@pytest.fixture(scope="module")
def busy(make_scenario, track, lane_centres) -> PolicyEnvironment:
    tracks = [
        track(1 + 3 * lane + k, x=60.0 + 20.0 * k, y=lane_centres[lane + 1], speed=9.0 + lane, last=45)
        for lane in range(3)
        for k in range(3)
    ]
    return PolicyEnvironment([make_scenario(*tracks)], SMALL)


@pytest.fixture(scope="module")
def lonely(make_scenario, track) -> PolicyEnvironment:
    """The ego has the road to itself."""
    return PolicyEnvironment([make_scenario(track(1, x=60.0, last=10))], SMALL)


def test_tracks_are_whole(busy, policy, config) -> None:
    tracks, rates = collect(HereDriving(busy), policy, config, 0)
    assert sum(len(track) for track in tracks) == rates["transitions"] >= config.transitions
    for track in tracks:
        assert len(track.observation) == len(track) + 1 and track.raw.shape == (len(track), 3)
        assert np.abs(track.executed).max() <= 1.0 and track.penalty.max() <= 0.0


class TwoCollide(PolicyEnvironment):
    """In the first step of an episode with an even seed, the first two agents collide, and the episode ends."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.seed = seed
        return super().reset(seed=seed, options=options)

    def step(self, action: np.ndarray) -> Any:
        observation, reward, _, truncated, info = super().step(action)
        outcome = info["outcome"]
        assert len(outcome.agents) >= 2
        hit = (np.arange(len(outcome.agents)) < 2) & (self.seed % 2 == 0)
        none = np.zeros(len(hit))
        vars(outcome).update(terms=Penalties(hit, none > 0, none, none, none, none > 0), terminated=hit)
        return observation, reward, bool(hit.any()), truncated or not hit.any(), info


def test_the_share_of_collided_episodes_counts_episodes(busy, policy, config) -> None:
    environment = TwoCollide(busy._scenarios, SMALL)
    rates = validate(policy, HereDriving(environment), config.model_copy(update={"validation_episodes": 4}))
    assert rates["validation_collided_share"] == 0.5, "two agents in each of two of four episodes"
    assert rates["validation_collisions"] > 0.0


def test_where_nobody_is_driven_training_ends_and_says_so(lonely, policy, config) -> None:
    assert drive(lonely, policy, 0, draws=False).tracks == []
    said = f"nobody is driven in {EMPTY_EPISODES_MAX} episodes in a row, expected scenarios"
    with pytest.raises(InputError, match=said):
        collect(HereDriving(lonely), policy, config, 0)


def test_a_validation_in_which_nobody_is_driven_is_no_perfect_score(lonely, policy, config) -> None:
    with pytest.raises(InputError, match="nobody is driven in the 2 episodes of validation"):
        validate(policy, HereDriving(lonely), config)


def test_an_episode_is_the_same_whatever_was_driven_before(busy, policy) -> None:
    first = drive(busy, policy, 5, draws=True)
    drive(busy, policy, 6, draws=True)
    again = drive(busy, policy, 5, draws=True)
    assert first.sums == again.sums and len(first.tracks) == len(again.tracks) > 0
    for one, other in zip(first.tracks, again.tracks, strict=True):
        assert np.array_equal(one.raw, other.raw) and np.array_equal(one.observation, other.observation)
