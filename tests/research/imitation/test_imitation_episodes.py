"""Episodes of GAIL: who is driven in them, what they do wrong, and what comes of it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from litsim_policy.driving.features.traffic_observation import SIZE
from litsim_research.baselines.imitation_policy import BOUNDS
from litsim_research.imitation.config import ImitationTraining
from litsim_research.imitation.episodes import TrafficEpisodes
from litsim_research.imitation.expert import traffic_pairs
from litsim_research.imitation.network import TrafficPolicy
from litsim_research.imitation.rollout import collect, drive, validate
from litsim_research.policies.data import DataConfig
from litsim_research.policies.expert import PairsConfig
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.scenario import Scenario


@pytest.fixture(scope="module")
def scenario(make_scenario: Any, track: Any) -> Scenario:
    """The ego at 100 m; 2 behind, 3 ahead, 4 far away, 5 a cyclist, 6 gone half a second after the history."""
    others = track(4, x=400.0), track(5, x=90.0, kind=Kind.BICYCLE), track(6, x=140.0, last=8)
    return make_scenario(track(1, x=100.0), track(2, x=80.0), track(3, x=115.0), *others)


def test_those_nearest_to_the_ego_are_driven(scenario: Scenario) -> None:
    everybody = TrafficEpisodes([scenario], 10, 60.0)
    assert everybody.batch.log.recorded_ids[everybody.agents].tolist() == [2, 3]
    assert everybody.seen.shape == (2, SIZE)
    nearest = TrafficEpisodes([scenario, scenario], 1, 60.0)
    assert [nearest.batch.recorded_id_in(k)(agent) for k, agent in enumerate(nearest.agents.tolist())] == [3, 3]


def test_who_is_told_to_do_as_he_does_stays_on_his_log(scenario: Scenario) -> None:
    episodes = TrafficEpisodes([scenario], 10, 60.0)
    for _ in range(10):
        step = episodes.step(np.zeros((2, 2)))
        assert step.executed == pytest.approx(np.zeros((2, 2)), abs=1e-6)
        assert step.error == pytest.approx(np.zeros(2), abs=1e-3)
        assert not step.worst.any()


def test_faults_are_what_rail_punishes(scenario: Scenario) -> None:
    episodes = TrafficEpisodes([scenario], 10, 60.0)
    braking = episodes.step(np.array([[-2.5, 0.0], [-2.5, 0.0]]) / BOUNDS)
    assert braking.hard_brake == pytest.approx([0.5, 0.5]) and braking.worst == pytest.approx([0.25, 0.25])
    off, touched = np.zeros(2), False
    for step in range(45):
        faults = episodes.step(np.array([[0.0, -1.0], [-1.0, 0.0]]))  # 2 turns off, 3 lets the ego come
        off = np.maximum(off, faults.off_road)
        touched |= step < 22 and bool(faults.contact[1])
    assert off.tolist() == [1.0, 0.0]
    assert not touched, "who is run into from behind could not help it"
    faults = replace(
        faults, contact=np.array([True, False]), off_road=np.array([0.2, 0.3]), hard_brake=np.array([1.0, 1.0])
    )
    assert faults.worst.tolist() == [1.0, 0.5]
    assert replace(faults, hard_brake=np.zeros(2)).worst.tolist() == [1.0, 0.3]


def test_who_drives_into_another_is_at_fault_and_drives_on(scenario: Scenario) -> None:
    episodes = TrafficEpisodes([scenario], 10, 60.0)
    steps = range(episodes.step_number, episodes.last_step)
    touched = [bool(episodes.step(np.array([[1.0, 0.0], [0.0, 0.0]])).contact[0]) for _ in steps]
    assert any(touched) and len(episodes.agents) == 2


def test_tracks_are_the_agents_own(scenario: Scenario) -> None:
    torch.manual_seed(0)
    policy = TrafficPolicy()
    drawn = drive([scenario, scenario.around(3, None)], policy, 10, 40.0, 12, torch.Generator().manual_seed(0))
    alone = TrafficEpisodes([scenario], 10, 40.0)
    assert len(drawn.tracks) == 4 and all(len(track) == 12 for track in drawn.tracks)
    for track, first in zip(drawn.tracks, alone.seen, strict=False):
        assert np.array_equal(track.observation[0], first)
        assert track.observation.shape == (13, SIZE) and not track.terminated
        density = policy.log_probability(
            *(torch.tensor(v, dtype=torch.float32) for v in (track.observation[:-1], track.raw))
        )
        assert track.log_probability == pytest.approx(density.detach().numpy(), abs=1e-4)
    means = [drive([scenario], policy, 10, 40.0, 12, None).tracks[0].raw for _ in range(2)]
    assert np.array_equal(*means) and not np.array_equal(means[0], drawn.tracks[0].raw)


def test_drivers_are_seen_as_they_drove(make_scenario: Any, track: Any) -> None:
    slower, faster = track(1, x=100.0, acceleration=-0.8), track(2, x=60.0, acceleration=1.0)
    scenarios = [make_scenario(slower, name="watched"), make_scenario(faster, name="people")]
    pairs = traffic_pairs(scenarios, PairsConfig(), np.random.default_rng(0), {"people"})
    recorded, _ = pairs.demonstrations(0.25)
    assert recorded.observation.shape[1] == SIZE
    assert set(np.round(recorded.action[:, 0].double().numpy(), 3).tolist()) == {-0.2, 0.25}
    assert float(torch.abs(recorded.action[:, 1]).max()) < 1e-6
    assert float(recorded.weight[recorded.action[:, 0] > 0].sum()) == pytest.approx(0.25)


def test_displaced_vehicles_are_shown_the_way_back(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(track(1, x=100.0), track(2, x=60.0))
    pairs = traffic_pairs([scenario], PairsConfig(turn=0.0), np.random.default_rng(0))
    lane_offset = (pairs.displaced - pairs.observation)[:, 3 + 4]
    far = np.abs(lane_offset) > 0.05
    assert far.sum() > 10 and (lane_offset * pairs.correction[:, 1] < 0)[far].all()
    assert np.array_equal(pairs.correction[:, 0], pairs.action[:, 0])
    assert len(pairs.demonstrations(0.5)[1].action) == 2 * len(pairs.action)


def test_where_nobody_is_driven_training_ends_and_nothing_is_scored(scenario: Scenario) -> None:
    config = ImitationTraining(data=DataConfig(), radius=1.0, validation_scenes=2)
    with pytest.raises(InputError, match=r"no agent is driven in 104 scenes in a row, .* within radius \(1 m\)"):
        collect([scenario], TrafficPolicy(), config, 0)
    with pytest.raises(InputError, match="no agent is driven in the 2 scenes of validation"):
        validate([scenario], TrafficPolicy(), config)
