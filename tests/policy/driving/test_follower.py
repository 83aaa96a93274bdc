"""Car following as people do it: each driver with the headway that it keeps."""

import numpy as np
import pytest

from litsim_policy.driving.follower import FASTER, Follower, FollowerConfig
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch

CONFIG = FollowerConfig()
LENGTH, SPEED = 4.5, 10.0


@pytest.fixture
def behind(make_scenario, track, lane_centres):
    """The car following, and agent 1 behind agent 2, which it has followed by `usual` [s] for `history` steps."""

    def at(gap: float, lead: float = SPEED, usual: float = 1.0) -> tuple[Follower, PathFollowers]:
        y = lane_centres[1]
        front = 100.0 + LENGTH + CONFIG.standstill_gap + usual * SPEED
        scenario = make_scenario(track(1, x=100.0, y=y), track(2, x=front, y=y))
        table = scenario.log.table(60)
        table.x[1], table.speed[1] = table.x[0] + LENGTH + gap, lead
        paths = PathBatch.of([np.array([[90.0, y], [500.0, y]])])
        return Follower(scenario, CONFIG), PathFollowers(scenario.lane_map, table, np.array([0]), paths)

    return at


@pytest.fixture
def acceleration(behind):
    """Acceleration of agent 1, which wants `wanted` and is off its log since step `since`."""

    def of(*where: float, wanted: float = 2.0, since: int = 0, **more: float) -> float:
        follower, agents = behind(*where, **more)
        return float(follower.limited(agents, np.array([wanted]), np.array([since]))[0])

    return of


def test_it_wants_no_more_than_its_log_and_brakes_no_harder_than_people(acceleration) -> None:
    assert acceleration(60.0, wanted=-0.3) == -0.3
    assert acceleration(5.0, 0.0) == -CONFIG.braking_max


def test_it_brakes_sooner_for_a_slower_leader(acceleration) -> None:
    assert acceleration(20.0, 7.0) < acceleration(20.0, 9.0) < acceleration(20.0)


def test_a_gap_that_is_merely_short_is_no_emergency(acceleration) -> None:
    assert -1.3 * CONFIG.deceleration < acceleration(3.0) < -0.8 * CONFIG.deceleration


def test_who_kept_more_distance_on_its_log_brakes_sooner(acceleration) -> None:
    near, far = (acceleration(12.0, usual=usual, since=60) for usual in (0.5, 2.5))
    assert far < acceleration(12.0, usual=0.5) < near
    assert acceleration(CONFIG.standstill_gap + SPEED) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(("lead", "expected"), [(10.4, 0.48), (15.0, 1.2 * (FASTER - 1.0) * SPEED), (9.0, 0.0)])
def test_it_goes_along_with_who_is_faster_than_its_log(behind, lead: float, expected: float) -> None:
    follower, agents = behind(20.0, lead)
    assert follower.along(agents, np.zeros(1), np.array([SPEED])) == pytest.approx([expected])
    follower, agents = behind(80.0, lead)
    assert follower.along(agents, np.zeros(1), np.array([SPEED])) == [0.0], "too far ahead"


def test_a_leader_far_ahead_does_not_hold_back(acceleration) -> None:
    assert acceleration(41.0) == 2.0 > acceleration(39.0)
    assert acceleration(41.0, 0.0) < 0.0, "but it is braked for"
