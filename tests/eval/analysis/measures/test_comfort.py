"""Comfort bounds, kept and broken one at a time."""

from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.comfort import BOUNDS, comfort, hard_brakes_begin, hard_brakes_in_log, motion_values
from litsim_sim.core.scene import Controller
from made_runs import table


def ride(accelerations: list[float], driven: range = range(0)) -> list[Any]:
    """Agent 1 as it accelerates, under control at the steps `driven`."""
    by = [Controller.POLICY if k in driven else Controller.LOG for k in range(len(accelerations))]
    return [
        table(k, {"id": 1, "x": 1.0 * k, "y": 0.0, "acceleration": a, "controller": by[k]})
        for k, a in enumerate(accelerations)
    ]


def test_a_steady_ride_is_comfortable() -> None:
    found = comfort(ride([0.0] * 10), 1, 0.1)
    assert found is not None
    assert found.comfortable
    assert found.within == dict.fromkeys(BOUNDS, 1.0)
    assert found.hard_brakes == 0


def test_braking_beyond_the_bound() -> None:
    found = comfort(ride([0.0, 0.0, -5.0, -5.0, 0.0, 0.0, -3.5, 0.0, 0.0, 0.0]), 1, 0.1)
    assert found is not None
    assert not found.comfortable
    assert found.within["longitudinal_acceleration"] == pytest.approx(0.8)  # -3.5 is within
    assert found.within["longitudinal_jerk"] == pytest.approx(5 / 9)
    assert found.hard_brakes == 2


@pytest.mark.parametrize(
    ("accelerations", "begins"),
    [
        ([0.0, -3.5, -2.5, -3.5, -1.5, -3.5, 0.0], [1]),  # one manoeuvre, around the threshold
        ([0.0, -3.5, -0.5, -3.5, 0.0, 0.0, -4.0], [1, 3, 6]),  # the brake was let go in between
        ([-4.0, -4.0, 0.0], [0]),
        ([0.0, -3.0, -3.0 - 1e-9, -3.0, 0.0], []),  # just 3 m/s2, but for the last digits
        ([], []),
    ],
)
def test_a_manoeuvre_is_counted_once(accelerations: list[float], begins: list[int]) -> None:
    assert np.flatnonzero(hard_brakes_begin(np.array(accelerations))).tolist() == begins


def test_hard_brakes_under_control_are_not_those_on_the_log() -> None:
    """It brakes at steps 1, 4 and 7; who is taken over while it brakes has begun to by itself."""
    accelerations = [0.0, -4.0, 0.0, 0.0, -4.0, -4.0, 0.0, -4.0, 0.0]
    for driven, expected in ((range(0), 0), (range(1, 2), 1), (range(5, 7), 0), (range(4, 9), 2)):
        found = comfort(ride(accelerations, driven), 1, 0.1)
        assert found is not None and (found.hard_brakes, found.hard_brakes_driven) == (3, expected)


def test_hard_brakes_of_the_log_while_somebody_else_drives() -> None:
    run, log = ride([0.0] * 9, range(4, 9)), ride([0.0, -4.0, 0.0, 0.0, -4.0, -4.0, 0.0, -4.0, 0.0])
    assert hard_brakes_in_log(run, log, 1) == 2
    assert hard_brakes_in_log(run, log[:7], 1) == 1, "the log is over"
    assert hard_brakes_in_log(run, log, 2) == 0


def test_values_of_a_turn() -> None:
    values = motion_values(np.full(3, 10.0), np.zeros(3), np.array([0.2, 0.4, 0.4]), 0.1)
    assert values["lateral_acceleration"].tolist() == [2.0, 4.0, 4.0]
    assert values["yaw_acceleration"].tolist() == pytest.approx([2.0, 0.0])
    assert values["jerk"].tolist() == pytest.approx([20.0, 0.0])


def test_nothing_to_judge() -> None:
    assert comfort(ride([0.0, 0.0]), 1, 0.1) is None
    assert comfort(ride([0.0] * 5), 2, 0.1) is None


def test_a_change_over_steps_that_are_lost_is_no_jerk() -> None:
    """From 0 to 2 m/s2 while nobody looked: 20 m/s3 if that were one step."""
    tables = ride([0.0] * 5 + [0.5, 1.0, 1.5] + [2.0] * 5)
    lost = comfort([each for each in tables if not 5 <= each.step < 8], 1, 0.1)
    assert lost is not None
    assert lost.comfortable
    assert comfort(tables[::2], 1, 0.1) is None, "of no two steps in a row is any change known"
