"""Boxes that overlap in the log itself."""

from typing import Any

import numpy as np
import pytest

from litsim_sim.scenario.log_overlaps import ABOUT_THEN, IN_PLACE, ON_THE_WAY, LogOverlaps


@pytest.fixture(scope="module")
def overlaps(make_scenario: Any, track: Any, lane_centres: tuple[float, ...]) -> LogOverlaps:
    """Agent 2 drives into 1, which stands, from step 20 on (its front meets the rear at x = 95.5 m); 3 is beside."""
    still = track(1, x=100.0, speed=0.0, last=60), track(3, x=100.0, y=lane_centres[3], speed=0.0, last=60)
    return LogOverlaps(make_scenario(*still, track(2, x=75.4, speed=10.0, last=29)).log)


def exempted(overlaps: LogOverlaps, now: int, x: float, later: int = ABOUT_THEN) -> bool:
    """Whether 2, in row 1, may overlap 1, in row 0, at step `now` of its log, while 1 is at `x`."""
    return bool(overlaps.exempt(1, 0, np.array([now]), np.array([x]), np.array([-5.49]), later)[0])


def test_steps_of_overlap_are_those_of_both_logs(overlaps: LogOverlaps) -> None:
    assert overlaps.steps(0, 1).tolist() == overlaps.steps(1, 0).tolist() == list(range(21, 30))
    assert overlaps.steps(0, 2).tolist() == []


def test_of_many_pairs_it_is_known_which_overlap_at_all(overlaps: LogOverlaps) -> None:
    assert overlaps.any(np.array([[0, 1], [1, 0], [0, 2]])).tolist() == [True, True, False]
    assert overlaps.any(np.empty((0, 2), np.int64)).shape == (0,)


def test_an_overlap_is_exempt_about_when_the_log_has_it(overlaps: LogOverlaps) -> None:
    assert [exempted(overlaps, now, 100.0) for now in (10, 11, 25, 39, 40)] == [False, True, True, True, False]


def test_somebody_on_the_way_into_an_overlap_is_sooner(overlaps: LogOverlaps) -> None:
    assert not exempted(overlaps, 21 - ON_THE_WAY - 1, 100.0, ON_THE_WAY)
    assert exempted(overlaps, 21 - ON_THE_WAY, 100.0, ON_THE_WAY)
    assert not exempted(overlaps, 21 - ON_THE_WAY, 100.0)


def test_who_comes_back_meets_whom_the_log_has_there(overlaps: LogOverlaps) -> None:
    assert overlaps.meets(1, 0, 21 - ON_THE_WAY, 100.0, -5.49)
    assert not overlaps.meets(1, 0, 21 - ON_THE_WAY - 1, 100.0, -5.49)
    assert not overlaps.meets(1, 0, 25, 100.0 + 1.1 * IN_PLACE, -5.49), "he is elsewhere"
    assert not overlaps.meets(2, 0, 25, 100.0, -5.49), "who never overlap"


def test_an_overlap_elsewhere_is_not_exempted(overlaps: LogOverlaps) -> None:
    assert exempted(overlaps, 25, 100.0 + 0.9 * IN_PLACE)
    assert not exempted(overlaps, 25, 100.0 + 1.1 * IN_PLACE)


def test_who_never_overlaps_is_never_exempted(overlaps: LogOverlaps) -> None:
    assert not overlaps.exempt(2, 0, np.arange(60), np.full(60, 100.0), np.full(60, -5.49), ON_THE_WAY).any()
