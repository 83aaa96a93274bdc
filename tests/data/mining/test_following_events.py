"""Braking ahead, stop-and-go, following: known numbers, and what is none."""

import numpy as np
import pytest

from litsim_data.mining.events import EventKind
from litsim_data.mining.following_events import (
    brake_threat,
    hard_braking,
    leader_braking,
    steady_following,
    stop_and_go,
)
from litsim_sim.core.scene import STEP_S
from made_traffic import braking, situation, straight

EGO, OTHER = 1, 2
BRAKES = [(0.0, 20.0), (4.0, 20.0), (5.0, 16.0), (12.0, 16.0)]  # 4 m/s2 for a second


def test_hard_braking_ahead_has_its_numbers() -> None:
    made = situation(straight(EGO, 0.0, 20.0, 1), braking(OTHER, 34.5, 1, BRAKES))
    (event,) = hard_braking(made)
    assert (event.kind, event.ego, event.other) == (EventKind.HARD_BRAKING, EGO, OTHER)
    assert event.begin * STEP_S == pytest.approx(4.0, abs=2 * STEP_S)
    assert event.end * STEP_S == pytest.approx(5.0, abs=2 * STEP_S)
    assert event.numbers["acceleration_min_mps2"] == pytest.approx(-4.0, abs=0.01)
    assert event.numbers["speed_lost_mps"] == pytest.approx(4.0, abs=0.81)  # a step at either end is missing
    assert event.numbers["headway_s"] == pytest.approx(1.5, abs=0.02)
    # The ego drives on: 30 m less 2 m of braking and 2 m/s2 lost later, over 4 m/s.
    assert event.numbers["ttc_min_s"] == pytest.approx((30.0 - 2.0 - 4.0 * 2.9) / 4.0, abs=0.2)
    assert [each.other for each in leader_braking(made)] == [OTHER]


@pytest.mark.parametrize(
    ("distance", "speeds", "is_braking"),
    [
        pytest.param(34.5, [(0, 20.0), (4, 20.0), (5, 17.2), (12, 17.2)], True, id="2.8 m/s2"),
        pytest.param(34.5, [(0, 20.0), (4, 20.0), (4.4, 18.4), (12, 18.4)], True, id="4 m/s2 for 0.4 s"),
        pytest.param(34.5, [(0, 20.0), (4, 20.0), (5, 18.0), (12, 18.0)], False, id="2 m/s2"),
        pytest.param(80.0, BRAKES, False, id="3.8 s ahead"),
        pytest.param(-34.5, BRAKES, False, id="behind"),
    ],
)
def test_what_is_no_hard_braking_ahead(distance: float, speeds: list[tuple[float, float]], is_braking: bool) -> None:
    made = situation(straight(EGO, 50.0, 20.0, 1), braking(OTHER, 50.0 + distance, 1, speeds))
    assert [event for event in hard_braking(made) if event.ego == EGO] == []
    assert any(event.ego == EGO for event in leader_braking(made)) == is_braking


def test_braking_in_another_lane_is_nothing_to_the_ego() -> None:
    made = situation(straight(EGO, 0.0, 20.0, 1), braking(OTHER, 34.5, 2, BRAKES))
    assert list(leader_braking(made)) == []


def test_the_brake_threat_is_the_share_of_full_braking_that_just_suffices() -> None:
    # Both brake fully from the same speed at the same distance: the one behind needs less by its gap.
    assert brake_threat(0.0, 20.0, 20.0, 7.59) == pytest.approx(1.0)
    assert brake_threat(20.0, 20.0, 0.0, 1.0) == pytest.approx(20.0**2 / 40.0 / 7.59)
    assert brake_threat(0.0, 20.0, 0.0, 1.0) == np.inf
    assert brake_threat(0.0, 0.0, 0.0, 1.0) == 0.0


def test_stop_and_go_is_between_going_and_going_behind_a_leader() -> None:
    speeds = [(0.0, 10.0), (2.0, 10.0), (5.0, 1.0), (7.0, 1.0), (10.0, 10.0), (12.0, 10.0)]
    (event,) = stop_and_go(situation(braking(EGO, 0.0, 1, speeds), braking(OTHER, 20.0, 1, speeds)))
    assert (event.ego, event.other) == (EGO, OTHER)
    assert event.numbers["speed_min_mps"] == pytest.approx(1.0, abs=0.01)
    assert event.numbers["stopped_s"] == pytest.approx(2.0 + 2.0 / 3.0, abs=2 * STEP_S)  # 2 m/s is 1/3 s from 1 m/s
    assert event.numbers["gap_min_m"] == pytest.approx(15.5, abs=0.01)
    assert event.numbers["ttc_min_s"] is None  # both do the same: nothing closes
    assert event.begin * STEP_S == pytest.approx(2.0 + 5.0 / 3.0, abs=2 * STEP_S)
    assert event.end * STEP_S == pytest.approx(7.0 + 4.0 / 3.0, abs=2 * STEP_S)


def test_creeping_between_two_stops_is_no_time_below_2_metres_a_second() -> None:
    speeds = [
        (0.0, 10.0),
        (2.0, 1.0),
        (3.0, 1.0),
        (4.0, 4.0),
        (6.0, 4.0),
        (7.0, 1.0),
        (8.0, 1.0),
        (10.5, 10.0),
        (12.0, 10.0),
    ]
    (event,) = stop_and_go(situation(braking(EGO, 0.0, 1, speeds), braking(OTHER, 20.0, 1, speeds)))
    # twice a second at 1 m/s, and what is below 2 m/s of slowing down and speeding up
    assert event.numbers["stopped_s"] == pytest.approx(2.0 + 2.0 / 9.0 + 2.0 / 3.0 + 2.5 / 9.0, abs=4 * STEP_S)


@pytest.mark.parametrize(
    ("speeds", "distance"),
    [
        pytest.param([(0.0, 10.0), (5.0, 3.0), (10.0, 10.0)], 20.0, id="only slow"),
        pytest.param([(0.0, 10.0), (5.0, 1.0), (12.0, 1.0)], 20.0, id="does not go again"),
        pytest.param([(0.0, 1.0), (5.0, 1.0), (10.0, 10.0)], 20.0, id="did not go before"),
        pytest.param([(0.0, 10.0), (5.0, 1.0), (10.0, 10.0)], 60.0, id="nobody near"),
    ],
)
def test_what_is_no_stop_and_go(speeds: list[tuple[float, float]], distance: float) -> None:
    made = situation(braking(EGO, 0.0, 1, speeds), braking(OTHER, distance, 1, speeds))
    assert [event for event in stop_and_go(made) if event.ego == EGO] == []


def test_following_is_steady_at_a_headway() -> None:
    (event,) = steady_following(situation(straight(EGO, 0.0, 20.0, 1), straight(OTHER, 34.5, 20.0, 1)))
    assert event.numbers["headway_s"] == pytest.approx(1.5, abs=0.01)
    assert event.numbers["duration_s"] == pytest.approx(12.1, abs=0.01)  # all steps
    assert event.severity == pytest.approx(0.9 / 2.4, abs=0.01)


@pytest.mark.parametrize(
    ("distance", "speed"),
    [
        pytest.param(16.5, 20.0, id="headway 0.6 s"),
        pytest.param(66.5, 20.0, id="headway 3.1 s"),
        pytest.param(46.5, 16.0, id="4 m/s faster"),
        pytest.param(-30.0, 20.0, id="nobody ahead"),
    ],
)
def test_what_is_no_following(distance: float, speed: float) -> None:
    made = situation(straight(EGO, 40.0, 20.0, 1, 4.0), straight(OTHER, 40.0 + distance, speed, 1, 4.0))
    assert [event for event in steady_following(made) if event.ego == EGO] == []
