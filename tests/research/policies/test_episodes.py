"""Episodes of the training: the same for the same seed, and over when they should be."""

from dataclasses import replace

import numpy as np
import pytest

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_research.policies.episodes import Course, EnvironmentConfig, Episodes, Outcome
from litsim_research.policies.expert import ExpertConfig, expert_pairs
from litsim_research.policies.reward import PenaltyConfig, displacement, penalties
from litsim_research.policies.task import TaskConfig
from litsim_sim.scenario.scenario import Scenario

SMALL = EnvironmentConfig(steps_max=40, slots=4, sampled=2, sample_steps=40)


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


def begun(scenario: Scenario, config: EnvironmentConfig = SMALL, seed: int = 0) -> Episodes:
    """An episode, at its first step with a driven agent."""
    course = Course([scenario], config)
    episodes = Episodes(course, [course.start(np.random.default_rng(seed))])
    while episodes.running[0] and not len(episodes.driven):
        episodes.step(np.empty((0, 3)))
    return episodes


def driven(episodes: Episodes, action: float = 0.0, lateral: float = 0.0) -> list[Outcome]:
    """Outcomes of the steps of an episode to its end, in which all actions are the same."""
    outcomes = []
    while episodes.running[0]:
        outcome = episodes.step(np.tile([action, lateral, lateral], (len(episodes.driven), 1)))
        outcomes += [outcome] if len(outcome.agents) else []
    return outcomes


def test_equal_seeds_give_equal_episodes(traffic) -> None:
    first, second, other = (driven(begun(traffic, seed=seed)) for seed in (3, 3, 4))
    assert len(first) > 5 and first == second and first != other


def test_who_makes_others_brake_shares_their_penalties(make_scenario, track, lane_centres) -> None:
    """The one ahead brakes as hard as it may, so that the one behind, who brakes as hard, is taken over."""
    y = lane_centres[1]
    tracks = [track(k, x=150.0 - 12.0 * k, y=y, speed=12.0, last=80) for k in range(1, 6)]
    scenario, config = make_scenario(*tracks), EnvironmentConfig(steps_max=40, slots=6, sampled=5, sample_radius=90.0)

    def braking(share: float) -> list[Outcome]:
        course = Course([scenario], config, penalty=PenaltyConfig(share=share))
        return driven(Episodes(course, [course.start(np.random.default_rng(0))]), action=-1.0)

    alone, shared = braking(0.0), braking(1.0)
    assert [each.agents.tolist() for each in alone] == [each.agents.tolist() for each in shared]
    more = [(a.penalty - b.penalty).min() for a, b in zip(shared, alone, strict=True) if len(a.agents)]
    assert min(more) < 0.0 and all((a.penalty <= b.penalty).all() for a, b in zip(shared, alone, strict=True))


def test_driven_agents_are_observed_and_outcomes_say_what_was_driven(traffic) -> None:
    episodes = begun(traffic, seed=1)
    agents = episodes.batch.log.recorded_ids[episodes.driven]
    assert 2 <= len(agents) <= SMALL.slots and (np.diff(agents) > 0).all()
    assert (np.abs(episodes.seen).sum(axis=1) > 0).all() and len(episodes.seen) == len(agents)
    assert traffic.ego_id not in agents
    outcome = episodes.step(np.zeros((len(episodes.driven), 3)))
    assert outcome.driven_on.any()
    for agent, following in zip(outcome.agents[outcome.driven_on], outcome.following[outcome.driven_on], strict=True):
        assert (episodes.seen[episodes.driven == agent] == following).all(), "what the next step begins with"
    for _ in range(6):
        outcome = episodes.step(np.tile([-0.2, 0.0, 0.0], (len(episodes.driven), 1)))
    count = len(outcome.agents)
    assert outcome.following.shape == (count, ObservationConfig().size) and outcome.executed.shape == (count, 3)
    assert outcome.executed[:, 0] == pytest.approx(np.full(count, -0.2), abs=0.02)


def test_only_sampled_agents_are_driven_where_that_is_asked_for(traffic) -> None:
    course = Course([traffic], EnvironmentConfig(steps_max=40, slots=1, sampled=1, sample_steps=40))
    for seed in range(6):
        episodes = Episodes(course, [course.start(np.random.default_rng(seed))], sampled_only=True)
        (agent,) = episodes.driven
        assert {each for outcome in driven(episodes) for each in outcome.agents.tolist()} == {agent}


@pytest.mark.parametrize("steps_max", [7, 12])
def test_time_runs_out(make_scenario, track, lane_centres, steps_max: int) -> None:
    tracks = [track(1 + k, x=60.0 + 40.0 * k, y=lane_centres[1 + k % 2], last=80) for k in range(4)]
    scenario = make_scenario(*tracks)
    episodes = begun(scenario, EnvironmentConfig(steps_max=steps_max, slots=2, sampled=3))
    outcomes = driven(episodes)
    assert not any(outcome.terminated.any() for outcome in outcomes) and not outcomes[-1].driven_on.any()
    assert max(len(outcome.agents) for outcome in outcomes) <= 2
    assert episodes.step_number == scenario.history_steps + steps_max < scenario.total_steps
    assert EnvironmentConfig().steps_max == 300, "the paper's"


def test_collisions_end_episodes(traffic) -> None:
    ends = [driven(begun(traffic, seed=seed), action=0.99)[-1] for seed in range(4)]
    collided = [end for end in ends if end.terminated.any()]
    assert any(end.terms.collision.any() for end in collided)
    for end in collided:
        assert not end.driven_on.any() and end.penalty[end.terminated].max() <= -PenaltyConfig().collision


@pytest.mark.parametrize("ends", [True, False])
def test_leaving_the_road_ends_episodes_unless_that_is_said(make_scenario, track, lane_centres, *, ends: bool) -> None:
    scenario = make_scenario(track(1, x=60.0, last=80), track(2, x=80.0, y=lane_centres[0], last=80))
    config = EnvironmentConfig(steps_max=60, slots=2, sampled=1, off_road_ends=ends)
    *before, last = driven(begun(scenario, config), lateral=0.3)
    assert sum(int(o.terms.off_road.sum()) for o in (*before, last)) == 1
    assert not any(o.terminated.any() for o in before)
    assert last.terminated.any() == last.terms.off_road.any() == ends


@pytest.mark.parametrize("seed", [1, 2])
def test_a_road_that_empties_is_no_failure(make_scenario, track, seed: int) -> None:
    """The ego and the driven agent leave the net at 640 m; the recording goes on, as somebody enters later."""
    tracks = track(1, x=560.0, speed=20.0, last=30), track(2, x=540.0, speed=20.0, last=30)
    scenario = make_scenario(*tracks, track(3, x=100.0, first=120, last=130))
    episodes = begun(scenario, EnvironmentConfig(slots=2, sampled=2), seed)
    outcomes = driven(episodes, action=0.9)
    assert {tuple(episodes.batch.log.recorded_ids[outcome.agents]) for outcome in outcomes} == {(2,)}
    left = outcomes[-1]
    assert (left.following == outcomes[-2].following).all(), "the last observation that there is"
    assert not left.driven_on.any() and not left.terminated.any() and left.penalty.tolist() == [0.0]
    assert episodes.step_number == scenario.total_steps


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
    found = penalties(before, after, np.array([1, 2, 3]), traffic.lane_map, guarded, np.zeros(3))
    assert found.collision.tolist() == [True, False, False], "who is run into from behind could not help it"
    assert found.hard_brake == pytest.approx([0.5, 0.0, 0.0])
    assert found.proximity[0] == 1.0 and found.proximity[2] == 0.0
    assert found.edge[2] > 0.9 and found.off_road.tolist() == [False, False, True]
    again = penalties(after, after, np.array([1, 2, 3]), traffic.lane_map, guarded, np.zeros(3))
    assert not again.collision.any() and not again.off_road.any(), "each counts once"
    assert (found.total(PenaltyConfig()) <= 0.0).all()
    assert found.total(PenaltyConfig())[1] == -PenaltyConfig().guard


def test_displacement_is_what_the_distance_from_the_log_grows_by(traffic, placed) -> None:
    before, after = traffic.log.table(4), traffic.log.table(5)
    ids = before.id[:2]
    for lost, grown in ((0.4, 0.4), (-0.5, 0.5)):
        moved = placed(after, int(ids[0]), x=float(after.x[0]) - lost)
        assert displacement(before, moved, ids, traffic.log) == pytest.approx([grown, 0.0])
    away = placed(before, int(ids[0]), x=float(before.x[0]) - 2.0)
    assert displacement(away, after, ids, traffic.log)[0] == pytest.approx(-2.0)
    assert displacement(away, replace(after, step=10**6), ids, traffic.log).tolist() == [0.0, 0.0], "its log is over"


@pytest.mark.parametrize("ends", [True, False])
def test_nothing_is_expected_of_who_is_handed_back_where_that_is_said(traffic, *, ends: bool) -> None:
    """Agents that keep their speed return to their logs, at the latest when these end."""
    config = replace(SMALL, sampled=0, steps_max=70, handback_ends=ends)
    course, over = Course([traffic], config), []
    for seed in range(6):
        outcomes = driven(Episodes(course, [course.start(np.random.default_rng(seed))]))
        over += [o.terminated[~o.driven_on] for o in outcomes if not (o.terms.collision | o.terms.off_road).any()]
    assert np.concatenate(over).any() == ends


def test_sampled_agents_are_driven_to_the_ends_of_their_logs_where_a_hand_back_ends_the_costs(
    make_scenario, track
) -> None:
    """Their logs end on the road, ahead of the ego and long before the recording does."""
    tracks = track(1, x=100.0, last=200), track(2, x=140.0, last=40)
    scenario = make_scenario(*tracks)
    for ends in (True, False):
        config = EnvironmentConfig(steps_max=150, slots=2, sampled=1, sample_steps=150, handback_ends=ends)
        course = Course([scenario], config)
        outcomes = driven(Episodes(course, [course.start(np.random.default_rng(0))]))
        last = outcomes[-1]
        assert bool(last.terminated[0]) == ends and not last.driven_on[0]
        assert (len(outcomes) < 60) == ends


def test_corrections_lead_back_to_the_path(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0), track(2, x=80.0))
    config = ExpertConfig(turn=0.0, every=2)
    pairs = expert_pairs([scenario], ObservationConfig(), config, TaskConfig(), np.random.default_rng(0))
    offset = pairs.displaced[:, -14]
    far = np.abs(offset) > 0.03
    assert far.sum() > 10 and (pairs.correction[far, 2] * offset[far] < 0).all()
