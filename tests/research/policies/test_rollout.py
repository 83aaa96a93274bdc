"""Episodes: whole tracks, what is counted by episode and what by agent, and an end where nobody is driven."""

import dataclasses

import numpy as np
import pytest
import torch

from litsim_research.policies import episodes
from litsim_research.policies.config import TrainConfig
from litsim_research.policies.episodes import Course, EnvironmentConfig
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.ppo import tensor
from litsim_research.policies.reward import Penalties
from litsim_research.policies.rollout import (
    AT_FIRST,
    AT_ONCE,
    EMPTY_EPISODES_MAX,
    collect,
    drawn_episodes,
    drive,
    driving_here,
    planned,
    validate,
)
from litsim_sim.core.errors import InputError

SMALL = EnvironmentConfig(steps_max=20, slots=4, sampled=3)


@pytest.fixture(scope="module")
def config() -> TrainConfig:
    return TrainConfig(data={}, transitions=40, validation_episodes=2, environment=SMALL)


@pytest.fixture(scope="module")
def policy(config: TrainConfig) -> GaussianPolicy:
    torch.manual_seed(0)
    return GaussianPolicy(config.observation)


@pytest.fixture(scope="module")
def busy(three_lanes) -> Course:
    return Course([three_lanes(9.0)], SMALL)


@pytest.fixture(scope="module")
def shorter(make_scenario, track, lane_centres) -> Course:
    """A recording that is over sooner, seen from farther, so that it cannot be joined with the other."""
    tracks = [track(10 * k, x=90.0 + 15.0 * k, y=lane_centres[1 + k % 2], speed=8.0 + k, last=17) for k in range(1, 7)]
    return Course([make_scenario(*tracks, roi_m=35.0), make_scenario(*tracks[::-1])], SMALL)


@pytest.fixture(scope="module")
def lonely(make_scenario, track) -> Course:
    """The ego has the road to itself."""
    return Course([make_scenario(track(1, x=60.0, last=10))], SMALL)


def test_tracks_are_whole(busy, policy, config) -> None:
    tracks, rates = collect(drawn_episodes(driving_here(busy, draws=True), policy, config, []))
    assert sum(len(track) for track in tracks) == rates["transitions"] >= config.transitions
    for track in tracks:
        assert len(track.observation) == len(track) + 1 and track.raw.shape == (len(track), 3)
        assert np.abs(track.executed).max() <= 1.0 and track.penalty.max() <= 0.0


def test_the_share_of_collided_episodes_counts_episodes(busy, policy, config, monkeypatch) -> None:
    """In their first steps the first two agents of every other episode collide; those end."""
    real = episodes.penalties

    def hit(before, after, agents, *others) -> Penalties:
        scene = before.scene[before.rows(agents)]
        place = np.arange(len(agents)) - np.searchsorted(scene, scene)
        collide = (place < 2) & (scene % 2 == 0)
        return dataclasses.replace(real(before, after, agents, *others), collision=collide)

    monkeypatch.setattr(episodes, "penalties", hit)
    longer = config.model_copy(update={"validation_episodes": 4})
    rates = validate(driving_here(busy, draws=False), policy, longer)
    assert rates["validation_collided_share"] == 0.5, "two agents in each of two of four episodes"
    assert rates["validation_collisions"] > 0.0


def test_where_nobody_is_driven_training_ends_and_says_so(lonely, policy, config) -> None:
    assert drive(lonely, policy, [0], draws=False)[0].tracks == []
    said = f"no agent is driven in {EMPTY_EPISODES_MAX} episodes in a row, expected scenarios"
    with pytest.raises(InputError, match=said):
        collect(drawn_episodes(driving_here(lonely, draws=True), policy, config, []))


def test_a_validation_in_which_nobody_is_driven_is_no_perfect_score(lonely, policy, config) -> None:
    with pytest.raises(InputError, match="no agent is driven in the 2 episodes of validation"):
        validate(driving_here(lonely, draws=False), policy, config)


def test_an_episode_is_the_same_in_whatever_company(busy, shorter, policy) -> None:
    """Alone, after others and beside others, on other roads too, to the last bit."""
    both = dataclasses.replace(busy, scenarios=[*shorter.scenarios, *busy.scenarios])
    seeds = list(range(9))
    together = drive(both, policy, seeds, draws=True)
    backwards = drive(both, policy, seeds[::-1], draws=True)[::-1]
    assert sum(len(episode.tracks) for episode in together) > 20
    assert len({sum(len(t) for t in episode.tracks) for episode in together}) > 1, "they must differ"
    for seed, one, other in zip(seeds, together, backwards, strict=True):
        (alone,) = drive(both, policy, [seed], draws=True)
        for same in (one, other):
            np.testing.assert_equal(dataclasses.asdict(same), dataclasses.asdict(alone))


def test_densities_are_those_that_training_takes_them_for(busy, policy) -> None:
    for track in drive(busy, policy, [3], draws=True)[0].tracks:
        seen, raw = tensor(track.observation[:-1]), tensor(track.raw)
        assert policy.log_probability(seen, raw).tolist() == pytest.approx(track.log_probability.tolist(), abs=1e-4)


def test_so_many_episodes_are_begun_as_are_likely_to_be_enough() -> None:
    history = [{"transitions": 150.0, "episodes": 1.0}, {"transitions": 650.0, "episodes": 3.0}]
    assert planned([], 1000.0) == AT_FIRST, "nothing is known yet"
    assert planned(history, 1000.0) == 7, "five hold as much in the mean, and a quarter more is begun"
    assert planned(history, 1.0) == 1
    assert planned(history, 1e6) == planned([{"transitions": 0.0, "episodes": 5.0}], 1000.0) == AT_ONCE


def test_an_iteration_goes_on_until_it_has_its_agent_steps_and_takes_all_that_was_driven(busy, policy, config) -> None:
    """One episode at a time is planned, by a history of long ones; three are needed."""
    steps = [sum(len(t) for t in e.tracks) for e in drive(busy, policy, _seeds(config, 1, 8), draws=True)]
    asked = config.model_copy(update={"transitions": sum(steps[:2]) + 1})
    history = [{"transitions": 1e6, "episodes": 1.0}]
    tracks, rates = collect(drawn_episodes(driving_here(busy, draws=True), policy, asked, history))
    assert rates["episodes"] == 3 and rates["transitions"] == sum(steps[:3]) == sum(len(t) for t in tracks)
    more = config.model_copy(update={"transitions": 1})
    history = [{"transitions": 0.5, "episodes": 2.0}]
    assert collect(drawn_episodes(driving_here(busy, draws=True), policy, more, history))[1]["episodes"] == 2, (
        "what is driven counts"
    )


def _seeds(config: TrainConfig, iteration: int, count: int) -> list[int]:
    sequences = (np.random.SeedSequence([config.seed, iteration, episode]) for episode in range(count))
    return [int(sequence.generate_state(1)[0]) for sequence in sequences]
