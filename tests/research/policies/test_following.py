"""People's car following in training: what is taken of it, and what is not."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from litsim_data.encounters.following import LANES, PAIRS, VEHICLES
from litsim_data.encounters.packaged import rows
from litsim_data.encounters.split import split_of
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.ego.log import LogEgo
from litsim_research.policies.data import DataConfig, prepare
from litsim_research.policies.draw import drawn_ego
from litsim_research.policies.expert import ExpertConfig, expert_pairs
from litsim_research.policies.following import HISTORY, following_scenarios, reported_drivers
from litsim_research.policies.task import TaskConfig
from litsim_sim.core.errors import InputError

Data = dict[str, list[str]]
FRAMES = 260


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forty followers 20 m behind leaders at 10 m/s on I-80, and files of other sources without vehicles."""
    folder = tmp_path_factory.mktemp("following")
    (folder / "ngsim").mkdir()
    way = 1.0 * np.arange(FRAMES)
    pairs = [
        pd.DataFrame(
            {
                "period": 1600,
                "pair": k,
                "frame": np.arange(FRAMES),
                "follower": 2000 + k,
                "leader": 5000 + k,
                "follower_y_m": way,
                "follower_speed_mps": 10.0,
                "leader_y_m": way + 24.7,
                "leader_speed_mps": 10.0,
                "leader_length_m": 4.7,
            }
        )
        for k in range(40)
    ]
    pd.concat(pairs).to_parquet(folder / PAIRS)
    lane = ("period", "lane", "vehicle_id", "frame", "local_y_m", "speed_mps", "class", "preceding", "preceding_y_m")
    single = ("period", "vehicle_id", "frame", "local_y_m", "speed_mps", "space_headway_m")
    for file, columns in ((LANES, lane), (VEHICLES, single)):
        pd.DataFrame({name: pd.Series(dtype=float) for name in columns}).to_parquet(folder / file)
    return folder


def test_nothing_is_taken_of_vehicles_that_are_reported_on(data: Path) -> None:
    train, validation = following_scenarios(data)
    tuning = {2000 + k for k in range(40) if split_of("i80", 1600, 2000 + k) == "tuning"}
    followers = [{int(s.log.ids[0]) for s in part} for part in (train, validation)]
    assert followers[0] | followers[1] == tuning and not followers[0] & followers[1]
    assert len(followers[1]) == len(tuning) // 10
    assert reported_drivers() == {r.agent for r in rows("reported") if r.site.startswith("us101") and r.period == 0}


def test_the_log_has_both_vehicles_as_they_drove(data: Path) -> None:
    scenario = following_scenarios(data)[0][0]
    assert scenario.history_steps == HISTORY and scenario.ego_id >= 5000
    follower, leader = (scenario.log.row(int(agent)) for agent in scenario.log.ids)
    gap = scenario.log.x[leader] - scenario.log.x[follower]
    assert gap == pytest.approx(np.full(scenario.total_steps + 1, 24.7), abs=0.01)
    assert scenario.log.speed == pytest.approx(10.0, abs=0.01)


def test_people_are_learned_from_together_and_leaders_with_nobody_ahead_are_not(data: Path) -> None:
    train, _ = following_scenarios(data)
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


def test_draws_fall_on_it_with_its_share(
    data: Path, training_data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LITSIM_DATA", str(data))
    found = prepare(DataConfig(**training_data, following=True, following_share=0.25), tmp_path)
    share = np.mean([scenario.name in found.real for scenario in found.train])
    assert share == pytest.approx(0.25, abs=0.01)
    monkeypatch.delenv("LITSIM_DATA")
    with pytest.raises(InputError, match=r"field following: LITSIM_DATA is not set, expected a folder with ngsim/i80"):
        prepare(DataConfig(**training_data, following=True), tmp_path)


def test_egos_drive_as_recorded_in_a_share_of_episodes(data: Path) -> None:
    scenario, random = following_scenarios(data)[0][0], np.random.default_rng(0)
    egos = [drawn_ego(scenario, random, recorded=0.4) for _ in range(300)]
    assert np.mean([isinstance(ego, LogEgo) for ego in egos]) == pytest.approx(0.4, abs=0.08)
