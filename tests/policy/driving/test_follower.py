"""Car following as people do it: each driver with the time gap that it usually keeps."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_policy.driving.follower import Follower, FollowerConfig
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.usual_gaps import PERIOD

CONFIG = FollowerConfig()
LENGTH = 4.5


@pytest.fixture
def behind(make_scenario, track, lane_centres, agent_table):
    """Acceleration of agent 1 behind agent 2, after `history` steps `usual` s behind it."""
    y = lane_centres[1]
    scenario = make_scenario(track(1, x=100.0), track(2, x=130.0))
    paths = PathBatch.of([np.array([[90.0, y], [500.0, y]])])

    def acceleration(gap: float, lead: float = 10.0, wanted: float = 2.0, usual: float = 1.35, history: int = 0):
        follower = Follower(scenario, CONFIG)
        for step in range(history):
            x = 100.0 + LENGTH + 10.0 * usual
            follower.observe(agent_table(step, {"id": 1, "x": 100.0, "y": y}, {"id": 2, "x": x, "y": y}))
        now = agent_table(0, {"id": 1, "x": 100.0, "y": y}, {"id": 2, "x": 100.0 + LENGTH + gap, "y": y, "speed": lead})
        agents = PathFollowers(scenario.lane_map, now, np.array([0]), paths)
        return float(follower.limited(agents, np.array([wanted]))[0])

    return acceleration


def test_it_keeps_still_at_the_wanted_gap(behind) -> None:
    assert behind(CONFIG.standstill_gap + 10.0 * CONFIG.headway) == pytest.approx(0.0, abs=1e-6)


def test_it_wants_no_more_than_its_log_and_brakes_no_harder_than_people(behind) -> None:
    assert behind(60.0, wanted=-0.3) == -0.3
    assert behind(5.0, lead=0.0) == -CONFIG.braking_max


def test_it_brakes_sooner_for_a_slower_leader(behind) -> None:
    assert behind(20.0, lead=7.0) < behind(20.0, lead=9.0) < behind(20.0)


def test_who_usually_stays_farther_behind_brakes_earlier(behind) -> None:
    near, usual, far = (behind(12.0, usual=gap, history=20 * PERIOD) for gap in (0.6, CONFIG.typical, 2.5))
    assert far < usual < near and usual == pytest.approx(behind(12.0))
