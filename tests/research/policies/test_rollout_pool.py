"""Episodes in several processes: the same as in one, in the same order."""

import multiprocessing
from collections.abc import Iterator
from dataclasses import asdict

import numpy as np
import pytest
import torch

from litsim_research.policies.config import TrainConfig
from litsim_research.policies.data import TrainingData
from litsim_research.policies.episodes import EnvironmentConfig
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.rollout import BATCH_MAX, Driving, Episode, collect, drawn_episodes, validate
from litsim_research.policies.rollout_pool import rollouts, shared_out

SMALL = EnvironmentConfig(steps_max=20, slots=4, sampled=3)


@pytest.fixture(scope="module")
def config() -> TrainConfig:
    return TrainConfig(data={}, transitions=150, validation_episodes=3, environment=SMALL)


@pytest.fixture(scope="module")
def data(three_lanes) -> TrainingData:
    return TrainingData((three_lanes(9.0),), (three_lanes(7.0),))


@pytest.fixture(scope="module")
def pool(data, config) -> Iterator[tuple[Driving, Driving]]:
    """Two processes, each of which takes seconds to import torch."""
    with rollouts(data, config, 2) as driving:
        yield driving


def policies(config: TrainConfig) -> list[GaussianPolicy]:
    """Two that drive differently: the processes are to notice that the weights change."""
    torch.manual_seed(0)
    return [GaussianPolicy(config.observation) for _ in range(2)]


def test_what_several_processes_drive_is_what_one_drives(data, config, pool) -> None:
    def drawn(driving: Driving, policy: GaussianPolicy) -> list[Episode]:
        return list(driving(policy, range(7, 12)))

    with rollouts(data, config, 1) as here:
        for policy in policies(config):
            alone, together = (drawn(driving, policy) for driving, _ in (here, pool))
            for one, other in zip(alone, together, strict=True):
                assert one.tracks
                np.testing.assert_equal(asdict(one), asdict(other))
            (tracks, rates), (same_tracks, same_rates) = (
                collect(drawn_episodes(driving, policy, config, [{"transitions": 90.0, "episodes": 1.0}]))
                for driving, _ in (here, pool)
            )
            assert rates == same_rates and len(tracks) == len(same_tracks)
            alone, together = (validate(v, policy, config) for _, v in (here, pool))
            assert alone == together
        first, second = (drawn(here[0], policy)[0] for policy in policies(config))
        assert not np.array_equal(first.tracks[0].raw, second.tracks[0].raw)


def test_groups_are_cut_where_one_process_would_be_busy_for_long() -> None:
    assert shared_out([[1], [0, 2, 3, 4, 5]], 3) == [[0, 2], [3, 4], [1], [5]]
    assert shared_out([[0], [1]], 4) == [[0], [1]], "there are no more"
    assert shared_out([range(12)], 2) == [range(6), range(6, 12)]
    assert shared_out([range(BATCH_MAX + 1)], 1) == [range(BATCH_MAX), range(BATCH_MAX, BATCH_MAX + 1)], (
        "so many are not stepped together"
    )


def test_a_pool_that_is_not_needed_ends_without_a_word(data, config, capfd) -> None:
    others = {process.pid for process in multiprocessing.active_children()}
    with rollouts(data, config, 2):
        pass  # as a training that is resumed when it is complete: its processes have not begun yet
    for process in multiprocessing.active_children():
        if process.pid not in others:
            process.join()
    assert capfd.readouterr().err == ""
