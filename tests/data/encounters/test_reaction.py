import numpy as np
import pytest

from litsim_data.encounters.reaction import TTC_MAX, Reaction, reaction
from litsim_sim.scenario.encounter_note import EncounterKind, Track

CAR = (4.0, 2.0)
ONSET = 10


def driven(speed: np.ndarray, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Track:
    """A vehicle that drives straight on along `yaw` at `speed` (T,), from `x`, `y`."""
    way = np.concatenate([[0.0], np.cumsum(0.05 * (speed[1:] + speed[:-1]))])
    return Track(x + way * np.cos(yaw), y + way * np.sin(yaw), np.full(len(speed), yaw), speed)


def braking(begin: int, rate: float, least: float = 0.0) -> np.ndarray:
    """Speeds of a vehicle at 10 m/s that brakes by `rate` from step `begin` on."""
    return np.maximum(10.0 - rate * 0.1 * np.clip(np.arange(71) - begin, 0, None), least)


def measured(kind: EncounterKind, agent: Track, opponent: Track) -> Reaction:
    return reaction(kind, agent, opponent, ONSET, CAR, CAR)


def test_a_follower_that_brakes_behind_its_leader() -> None:
    leader, follower = driven(braking(ONSET, 2.0, 6.0), x=14.0), driven(braking(ONSET + 10, 2.0, 6.0))
    what = measured("leader_brakes", follower, leader)
    assert what.onset == pytest.approx(1.3)  # 1 s late, then 0.3 s for more than 0.5 m/s
    assert what.strongest_braking == pytest.approx(-2.0)
    assert what.speed_lost == pytest.approx(4.0)
    assert what.least_gap == pytest.approx(10.0 - 4.0)  # 1 s late at 4 m/s less
    assert what.least_ttc == pytest.approx(7.0 / 2.0, abs=0.2)
    assert what.position == pytest.approx([follower.x[ONSET + 50], 0.0])
    assert not what.contact


def test_a_follower_that_never_reacts() -> None:
    leader, follower = driven(braking(ONSET, 2.0, 2.0), x=14.0), driven(np.full(71, 10.0))
    what = measured("leader_brakes", follower, leader)
    assert np.isnan(what.onset) and what.contact
    assert what.strongest_braking == what.speed_lost == what.least_ttc == 0.0


def test_no_approach_has_the_largest_time_to_collision() -> None:
    what = measured("leader_brakes", driven(np.full(71, 10.0)), driven(np.full(71, 10.0), x=30.0))
    assert what.least_ttc == TTC_MAX


def test_a_gap_is_measured_along_the_bend_that_both_drive() -> None:
    angle = np.arange(71) / 20.0 / 2.0  # 1 m a step on a circle of 40 m
    circle = [Track(40 * np.sin(a), 40 - 40 * np.cos(a), a, np.full(71, 10.0)) for a in (angle, angle + 0.5)]
    assert measured("leader_brakes", *circle).least_gap == pytest.approx(0.5 * 40 - 4.0, abs=0.1)


def test_a_vehicle_beside_the_path_leaves_no_gap_until_it_cuts_in() -> None:
    agent, beside = driven(np.full(71, 10.0)), driven(np.full(71, 10.0), x=12.0, y=3.5)
    assert measured("cut_in", agent, beside).least_gap == np.inf
    y = 3.5 * np.clip((40 - np.arange(71)) / 20, 0, 1)
    assert measured("cut_in", agent, Track(beside.x, y, beside.yaw, beside.speed)).least_gap == pytest.approx(8.0)


def test_crossing_paths_are_measured_by_boxes() -> None:
    agent, crossing = driven(np.full(71, 10.0), x=-40.0), driven(np.full(71, 10.0), y=-31.0, yaw=np.pi / 2)
    what = measured("crossing", agent, crossing)
    assert what.least_gap == pytest.approx(1.5 * np.sqrt(2), abs=0.2)  # the second passes 0.9 s later
    assert what.least_ttc == TTC_MAX and not what.contact


def test_crossing_on_a_collision_course() -> None:
    agent, crossing = driven(np.full(71, 10.0), x=-40.0), driven(np.full(71, 10.0), y=-40.0, yaw=np.pi / 2)
    what = measured("crossing", agent, crossing)
    assert what.contact and what.least_gap == what.least_ttc == 0.0
