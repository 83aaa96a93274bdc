"""People's car following in training: what is taken of it, and what is not."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from litsim_data.encounters.following import FollowingTrack
from litsim_data.encounters.packaged import rows
from litsim_data.encounters.split import split_of
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.ego.log import LogEgo
from litsim_research.policies import following
from litsim_research.policies.data import DataConfig, prepare
from litsim_research.policies.draw import drawn_ego
from litsim_research.policies.expert import ExpertConfig, expert_pairs
from litsim_research.policies.following import HISTORY, following_scenarios, reported_drivers
from litsim_research.policies.task import TaskConfig
from litsim_sim.core.errors import InputError

Data = dict[str, list[str]]
FRAMES = 260
DATA = Path("data")
"""Folder of the files, which are not read."""


@pytest.fixture(scope="module", autouse=True)
def _forty_followers() -> Iterator[None]:
    """20 m behind their leaders on I-80, all at 10 m/s."""
    way, speed = 1.0 * np.arange(FRAMES), np.full(FRAMES, 10.0)
    tracks = [FollowingTrack("i80", 1600, 2000 + k, 5000 + k, 4.7, 0, way, speed, way + 20.0, speed) for k in range(40)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(following, "following_tracks", lambda _: iter(tracks))
        yield


def test_nothing_is_taken_of_vehicles_that_are_reported_on() -> None:
    train, validation = following_scenarios(DATA)
    tuning = {2000 + k for k in range(40) if split_of("i80", 1600, 2000 + k) == "tuning"}
    followers = [{int(s.log.ids[0]) for s in part} for part in (train, validation)]
    assert followers[0] | followers[1] == tuning and not followers[0] & followers[1]
    assert len(followers[1]) == len(tuning) // 10
    assert reported_drivers() == {r.agent for r in rows("reported") if r.site.startswith("us101") and r.period == 0}


def test_the_log_has_both_vehicles_as_they_drove() -> None:
    scenario = following_scenarios(DATA)[0][0]
    assert scenario.history_steps == HISTORY and scenario.ego_id >= 5000
    follower, leader = (scenario.log.row(int(agent)) for agent in scenario.log.ids)
    gap = scenario.log.x[leader] - scenario.log.x[follower]
    assert gap == pytest.approx(np.full(scenario.total_steps + 1, 24.7), abs=0.01)
    assert scenario.log.speed == pytest.approx(10.0, abs=0.01)


def test_people_are_learned_from_together_and_leaders_with_nobody_ahead_are_not() -> None:
    train, _ = following_scenarios(DATA)
    real = {scenario.name for scenario in train}

    def pairs(**more: dict[str, list[int]]) -> int:
        random = np.random.default_rng(0)
        found = expert_pairs(train, ObservationConfig(), ExpertConfig(), TaskConfig(), random, real, **more)
        assert found.real.all() and found.action[:, 0] == pytest.approx(0.0, abs=0.01)
        return len(found.action)

    first = train[0]
    own = -(-(first.log.steps - ExpertConfig().horizon) // ExpertConfig().every)
    assert pairs() - pairs(reported={first.name: [int(first.log.ids[0])]}) == own
    assert pairs(reported={first.name: [int(first.log.ids[1])]}) == pairs(), "leaders show nothing"


def test_draws_fall_on_it_with_its_share(training_data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LITSIM_DATA", str(DATA))
    found = prepare(DataConfig(**training_data, following=True, following_share=0.25), tmp_path)
    share = np.mean([scenario.name in found.real for scenario in found.train])
    assert share == pytest.approx(0.25, abs=0.01)
    monkeypatch.delenv("LITSIM_DATA")
    with pytest.raises(InputError, match=r"field following: LITSIM_DATA is not set, expected a folder with ngsim/i80"):
        prepare(DataConfig(**training_data, following=True), tmp_path)


def test_egos_drive_as_recorded_in_a_share_of_episodes() -> None:
    scenario, random = following_scenarios(DATA)[0][0], np.random.default_rng(0)
    egos = [drawn_ego(scenario, random, recorded=0.4) for _ in range(300)]
    assert np.mean([isinstance(ego, LogEgo) for ego in egos]) == pytest.approx(0.4, abs=0.08)
