"""The headway that a driver keeps, from its own record up to the step at which it leaves that."""

import numpy as np
import pytest

from litsim_policy.motion.car_following import IdmValues
from litsim_policy.motion.kept_headways import STRIDE, KeptHeadways, headway_of_look

MODEL, LOOKS = IdmValues(1.0, 2.0, 1.0, 1.5, 3.0), 4.0
LENGTH, SPEED = 4.5, 10.0
KEPT = 1.8  # [s]
GAP = MODEL.standstill_gap + KEPT * SPEED


@pytest.fixture
def headway(make_scenario, track, lane_centres):
    """Headway of agent 1, up to a step, in a scene in which it keeps KEPT behind agent 2 unless told otherwise."""

    def of(until: int, **leader: float) -> float:
        y = lane_centres[1]
        ahead = {"x": 100.0 + LENGTH + GAP, "y": y, "speed": SPEED} | leader
        scenario = make_scenario(track(1, x=100.0, y=y, speed=SPEED), track(2, **ahead))
        return float(KeptHeadways(scenario.log, MODEL, LOOKS).of(np.array([1]), np.array([until]))[0])

    return of


@pytest.mark.parametrize("looks", [1, 2, 11])
def test_the_more_looks_the_more_it_is_the_drivers_own(headway, looks: int) -> None:
    expected = (LOOKS * MODEL.headway + looks * KEPT) / (LOOKS + looks)
    assert headway(STRIDE * (looks - 1)) == pytest.approx(expected)


@pytest.mark.parametrize("leader", [{"y": -12.81}, {"x": 60.0}, {"x": 180.0}], ids=["beside", "behind", "far ahead"])
def test_who_follows_nobody_has_the_usual_headway(headway, leader: dict[str, float]) -> None:
    assert headway(50, **leader) == MODEL.headway


def test_what_comes_later_does_not_count(make_scenario, track) -> None:
    near, far = (make_scenario(track(1, x=100.0), track(2, x=128.0, acceleration=change)).log for change in (0.0, 1.0))
    asked = np.array([1]), np.array([0])
    assert KeptHeadways(near, MODEL, LOOKS).of(*asked) == KeptHeadways(far, MODEL, LOOKS).of(*asked)


def test_who_slows_down_or_closes_in_keeps_more_than_the_gap_shows() -> None:
    still = headway_of_look(SPEED, 0.0, GAP, SPEED, MODEL)
    assert still == pytest.approx(KEPT)
    assert headway_of_look(SPEED, -0.5, GAP, SPEED, MODEL) > still > headway_of_look(SPEED, 0.0, GAP, 8.0, MODEL)
