"""The headway that a driver usually keeps, as recorded up to now."""

import numpy as np
import pytest

from litsim_policy.motion.habits import Habits, usual_headway
from litsim_policy.motion.log_leaders import VERTICES
from litsim_policy.motion.speed_change import USUAL_HEADWAY


def headway(log, *steps: int) -> float:
    """The usual headway of the first driver at the last of `steps`, at each of which it is asked for."""
    habits = Habits(log)
    return [usual_headway(habits.columns, 0, step, habits.seen, np.empty((VERTICES, 5))) for step in steps][-1]


def test_it_approaches_what_the_driver_keeps(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=124.5), coverage_min=0.0).log  # 20 m at 10 m/s
    values = [headway(log, step) for step in (0, 20, 50)]
    assert values == sorted(values) and values[0] > USUAL_HEADWAY and values[-1] == pytest.approx(1.8, abs=0.1)


def test_without_a_leader_it_is_the_usual_one(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=300.0), coverage_min=0.0).log
    assert headway(log, 50) == pytest.approx(USUAL_HEADWAY)


def test_later_steps_do_not_count(make_scenario, track) -> None:
    steady, brakes = (
        make_scenario(track(1, x=100.0), track(2, x=124.5, acceleration=a), coverage_min=0.0).log for a in (0.0, -0.1)
    )
    brakes.x[1, :31], brakes.speed[1, :31] = steady.x[1, :31], steady.speed[1, :31]
    assert headway(steady, 30) == headway(brakes, 30)
    assert headway(steady, 60) != headway(brakes, 60)


def test_it_goes_on_from_question_to_question(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=124.5), coverage_min=0.0).log
    assert headway(log, 0, 10, 40) == pytest.approx(headway(log, 40))
