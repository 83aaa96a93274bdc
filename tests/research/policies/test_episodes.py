"""The environment: gymnasium's contract, the same for the same seed, and episodes that end when they should."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_research.policies.environment import EMPTY, EnvironmentConfig, PolicyEnvironment
from litsim_research.policies.episodes import Course, Episodes, Outcome
from litsim_research.policies.expert import ExpertConfig, expert_pairs
from litsim_research.policies.reward import PenaltyConfig, penalties
from litsim_research.policies.task import TaskConfig
from litsim_sim.scenario.scenario import Scenario

SMALL = EnvironmentConfig(steps_max=40, slots=4, drafted=2, draft_steps=40)


@pytest.fixture(scope="module")
def traffic(make_scenario, track, lane_centres) -> Scenario:
    """Three lanes of traffic, the ego in the middle of it."""
    tracks = [
        track(1 + 4 * lane + k, x=60.0 + 18.0 * k + 5.0 * lane, y=lane_centres[lane + 1], speed=10.0, last=80)
        for lane in range(3)
        for k in range(4)
    ]
    tracks.sort(key=lambda t: t.id != 7)
    return make_scenario(*tracks)


@pytest.fixture
def environment(traffic) -> PolicyEnvironment:
    return PolicyEnvironment([traffic], SMALL)


def episode(environment: PolicyEnvironment, seed: int, action: float = 0.0, lateral: float = 0.0) -> list[tuple]:
    """Steps of an episode in which all actions are the same."""
    environment.reset(seed=seed)
    chosen = np.tile([action, lateral, lateral], (environment.config.slots, 1))
    steps = []
    while True:
        steps.append(environment.step(chosen))
        if steps[-1][2] or steps[-1][3]:
            return steps


def test_contract(environment) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on float64 and on the range of rewards
        check_env(environment, skip_render_check=True)
    assert isinstance(environment, gymnasium.Env)


def test_equal_seeds_give_equal_episodes(environment, traffic) -> None:
    first, second = episode(environment, 3), episode(PolicyEnvironment([traffic], SMALL), 3)
    assert len(first) == len(second) > 5
    assert all((a[0] == b[0]).all() and a[1] == b[1] for a, b in zip(first, second, strict=True))
    other = episode(environment, 4)
    assert len(other) != len(first) or any((a[0] != b[0]).any() for a, b in zip(first, other, strict=False))


def test_who_makes_others_brake_shares_their_penalties(make_scenario, track, lane_centres) -> None:
    """The one ahead brakes as hard as it may, so that the one behind, who brakes as hard, is taken over."""
    y = lane_centres[1]
    tracks = [track(k, x=150.0 - 12.0 * k, y=y, speed=12.0, last=80) for k in range(1, 6)]
    scenario, config = make_scenario(*tracks), EnvironmentConfig(steps_max=40, slots=6, drafted=5, draft_radius=90.0)

    def driven(share: float) -> list[Outcome]:
        course = Course([scenario], config, penalty=PenaltyConfig(share=share))
        episodes, found = Episodes(course, [course.start(np.random.default_rng(0))]), []
        while episodes.running.any():
            found.append(episodes.step(np.tile([-1.0, 0.0, 0.0], (len(episodes.driven), 1))))
        return found

    alone, shared = driven(0.0), driven(1.0)
    assert [each.agents.tolist() for each in alone] == [each.agents.tolist() for each in shared]
    more = [(a.penalty - b.penalty).min() for a, b in zip(shared, alone, strict=True) if len(a.agents)]
    assert min(more) < 0.0 and all((a.penalty <= b.penalty).all() for a, b in zip(shared, alone, strict=True))


def test_slots_say_whose_they_are(environment) -> None:
    observation, info = environment.reset(seed=0)
    agents = info["agents"]
    taken = agents != EMPTY
    assert taken.sum() >= 2 and (np.diff(agents[taken]) > 0).all()
    assert (observation[~taken] == 0.0).all() and (np.abs(observation[taken]).sum(axis=1) > 0).all()
    assert environment.scenario.ego_id not in agents


def test_time_runs_out(environment) -> None:
    ends = [episode(environment, seed)[-1] for seed in range(4)]
    truncated = [end for end in ends if end[3]]
    assert truncated, "somebody drives on quietly"
    for _, _, terminated, _, info in truncated:
        assert not terminated and not info["outcome"].terminated.any() and not info["outcome"].driven_on.any()


def test_collisions_end_episodes(environment) -> None:
    ends = [episode(environment, seed, action=0.99)[-1] for seed in range(4)]
    collided = [end for end in ends if end[2]]
    assert collided
    for _, reward, _, truncated, info in collided:
        outcome = info["outcome"]
        assert not truncated and reward < 0.0
        assert outcome.terminated.any() and not outcome.driven_on.any()
        assert outcome.penalty[outcome.terminated].max() <= -PenaltyConfig().collision
    assert any(end[4]["outcome"].terms.collision.any() for end in collided)


def test_leaving_the_road_ends_episodes(make_scenario, track, lane_centres) -> None:
    scenario = make_scenario(track(1, x=60.0, last=80), track(2, x=80.0, y=lane_centres[0], last=80))
    environment = PolicyEnvironment([scenario], EnvironmentConfig(steps_max=60, slots=2, drafted=1))
    last = episode(environment, 0, lateral=0.3)[-1]
    assert last[2] and last[4]["outcome"].terms.off_road.any()


@pytest.mark.parametrize("seed", [1, 2])
def test_a_road_that_empties_is_no_failure(make_scenario, track, seed: int) -> None:
    """The ego and the driven agent leave the net at 640 m; the recording goes on, as somebody enters later."""
    tracks = track(1, x=560.0, speed=20.0, last=30), track(2, x=540.0, speed=20.0, last=30)
    scenario = make_scenario(*tracks, track(3, x=100.0, first=120, last=130))
    environment = PolicyEnvironment([scenario], EnvironmentConfig(slots=2, drafted=2))
    steps = episode(environment, seed, action=0.9)
    driven = [end[4]["outcome"] for end in steps]
    assert [outcome.agents.tolist() for outcome in driven[:-1]] == [[2]] * (len(driven) - 1)
    left = driven[-1]
    assert (left.following == driven[-2].following).all(), "the last observation that there is"
    assert not left.driven_on.any() and not left.terminated.any() and left.penalty.tolist() == [0.0]
    assert steps[-1][3] and steps[-1][4]["step"] == scenario.total_steps


def test_outcomes_say_what_was_driven(environment) -> None:
    environment.reset(seed=0)
    action = np.tile([-0.2, 0.0, 0.0], (SMALL.slots, 1))
    for _ in range(6):
        *_, info = environment.step(action)
    outcome = info["outcome"]
    count = len(outcome.agents)
    assert outcome.following.shape == (count, ObservationConfig().size) and outcome.executed.shape == (count, 3)
    assert outcome.executed[:, 0] == pytest.approx(np.full(count, -0.2), abs=0.02)


def test_following_observations_are_those_of_the_next_step(environment) -> None:
    environment.reset(seed=1)
    observation, *_, info = environment.step(np.zeros((SMALL.slots, 3)))
    outcome = info["outcome"]
    for k, agent in enumerate(outcome.agents.tolist()):
        if outcome.driven_on[k]:
            slot = int(np.flatnonzero(info["agents"] == agent)[0])
            assert (observation[slot] == outcome.following[k]).all()


# Penalties


def test_penalties(traffic, agent_table, lane_centres) -> None:
    y = lane_centres[1]
    before = agent_table(4, {"id": 1, "x": 100.0, "y": y}, {"id": 2, "x": 105.0, "y": y}, {"id": 3, "x": 60.0, "y": y})
    after = agent_table(
        5,
        {"id": 1, "x": 101.0, "y": y, "acceleration": -3.75},
        {"id": 2, "x": 105.0, "y": y},
        {"id": 3, "x": 61.0, "y": lane_centres[0] + 1.2},
    )
    guarded = np.array([False, True, False])
    found = penalties(before, after, np.array([1, 2, 3]), traffic.lane_map, guarded)
    assert found.collision.tolist() == [True, False, False], "who is run into from behind could not help it"
    assert found.hard_brake == pytest.approx([0.5, 0.0, 0.0])
    assert found.proximity[0] == 1.0 and found.proximity[2] == 0.0
    assert found.edge[2] > 0.9 and found.off_road.tolist() == [False, False, True]
    again = penalties(after, after, np.array([1, 2, 3]), traffic.lane_map, guarded)
    assert not again.collision.any() and not again.off_road.any(), "each counts once"
    assert (found.total(PenaltyConfig()) <= 0.0).all()
    assert found.total(PenaltyConfig())[1] == -PenaltyConfig().guard


# Experts


def test_experts_do_what_was_recorded(make_scenario, track, lane_centres) -> None:
    scenario = make_scenario(
        track(1, x=100.0, speed=10.0, acceleration=1.0), track(2, x=80.0, speed=10.0, acceleration=-0.6)
    )
    pairs = expert_pairs([scenario], ObservationConfig(), ExpertConfig(), TaskConfig(), np.random.default_rng(0))
    assert len(pairs.action) >= 10
    assert set(np.round(pairs.action[:, 0], 3)) <= {0.333, -0.1}
    assert np.abs(pairs.action[:, 1:]).max() < 1e-6
    assert np.isfinite(pairs.observation).all() and pairs.observation.shape == pairs.displaced.shape


def test_corrections_lead_back_to_the_path(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0), track(2, x=80.0))
    config = ExpertConfig(turn=0.0, every=2)
    pairs = expert_pairs([scenario], ObservationConfig(), config, TaskConfig(), np.random.default_rng(0))
    offset = pairs.displaced[:, -14]
    far = np.abs(offset) > 0.03
    assert far.sum() > 10 and (pairs.correction[far, 2] * offset[far] < 0).all()
