"""Severity, and what an event is in a file."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_data.mining.events import EventKind, Number, severity
from litsim_data.mining.lane_tracks import NOWHERE
from made_traffic import situation, straight


@pytest.mark.parametrize(
    "measure",
    [{"ttc": 2.0}, {"headway": 0.9}, {"pet": 1.5}, {"brake_threat": 1.0}, {"lateral_acceleration": 3.0}],
)
def test_half_is_the_criticality_target(measure: dict[str, float]) -> None:
    assert severity(**measure) == 0.5


def test_the_worst_measure_counts_and_what_is_missing_does_not() -> None:
    assert severity(ttc=2.0, headway=9.0, pet=None) == 0.5
    assert severity(ttc=None, headway=None) == 0.0
    assert severity(ttc=inf) == 0.0
    assert severity(ttc=0.0) == severity(brake_threat=inf) == 1.0


@given(st.floats(0.0, 1e3), st.floats(0.0, 1e3))
def test_what_may_not_be_small_is_worse_where_it_is_smaller(a: float, b: float) -> None:
    low, high = sorted((a, b))
    assert 0.0 <= severity(ttc=high) <= severity(ttc=low) <= 1.0
    assert 0.0 <= severity(brake_threat=low) <= severity(brake_threat=high) <= 1.0


def test_an_entry_has_times_in_seconds_and_nothing_in_place_of_what_is_missing() -> None:
    numbers: dict[str, Number] = {"ttc_s": inf, "gap_m": 1.23456}
    event = situation(straight(7, 20.0, 10.0, 2.0)).event(EventKind.CUT_IN, 0, NOWHERE, (30, 41, 52), 0.25, numbers)
    assert event.ego == 7
    assert event.entry() == {
        "kind": "cut_in",
        "other": None,
        "time_s": 4.1,
        "begin_s": 3.0,
        "end_s": 5.2,
        "severity": 0.25,
        "ttc_s": None,
        "gap_m": 1.235,
    }
