"""What people did: distances are quantiles, rise with what is unusual, and go on beyond what was recorded."""

from statistics import NormalDist

import numpy as np
import pytest

from litsim_data.mining.events import Situation
from litsim_eval.search.people import DECLARED, PARAMETERS, QUANTITIES, Habit, People, Rate, _counts
from litsim_sim.core.errors import InputError


@pytest.mark.parametrize("small", [False, True])
def test_distance_is_that_of_a_normal_distribution(small: bool) -> None:
    normal = np.abs(np.random.default_rng(0).normal(size=200_000))
    habit = Habit.of(5.0 - normal if small else normal, "m", small=small)
    for distance in (0.5, 1.0, 2.0, 2.7, 4.0):
        value = habit.value(distance)
        assert value == pytest.approx(5.0 - distance if small else distance, abs=0.15)
        assert habit.distance(value) == pytest.approx(distance, abs=1e-3)
    assert habit.distance(9.0 if small else -1.0) == 0.0


def test_every_parameter_has_a_habit() -> None:
    people = People.load()
    assert set(people.habits) == set(QUANTITIES)
    measured = {each.habit for each in PARAMETERS if not each.declared}
    assert measured <= set(people.habits) and {each.habit for each in PARAMETERS} - measured == set(DECLARED)
    for name, (_, small) in QUANTITIES.items():
        steps = np.diff(people.habits[name].values)
        assert (steps < 0).all() if small else (steps > 0).all()


def test_people_of_a_recording() -> None:
    people = People.of(["demo"])
    assert people.source == "demo"
    braking = people.habits["deceleration"]
    assert braking.moments > 500 and 0.2 < braking.value(1.0) < 1.5 < braking.value(4.0)
    assert people.habits["lane_change_s"].moments >= 10


def test_a_rate_is_a_distance_by_the_share_that_acts() -> None:
    rate = Rate(seconds=1000, begun=10)
    share = 1.0 - np.exp(-0.01 * 12.0)
    assert 2.0 * (1.0 - NormalDist().cdf(rate.distance(12.0))) == pytest.approx(share)
    assert rate.distance(6.0) > rate.distance(12.0) > rate.distance(1e6) == 0.0


@pytest.mark.parametrize(
    ("lane", "to_lane", "acceleration", "counts"),
    [
        (2, 1, 0.0, {"cut_in": (4, 1), "cut_out": (3, 0), "brake": (3, 0)}),  # beside for 3.1 s, then ahead
        (1, 2, 0.0, {"cut_in": (4, 0), "cut_out": (3, 1), "brake": (3, 0)}),  # ahead, then beside
        (1, 1, -1.0, {"cut_in": (0, 0), "cut_out": (7, 0), "brake": (7, 1)}),
    ],
)
def test_rates_are_of_those_who_were_there(
    make_scenario, track, lane_centres, lane: int, to_lane: int, acceleration: float, counts: dict
) -> None:
    yaw = np.arcsin((lane_centres[to_lane] - lane_centres[lane]) / 60.0)  # 60 m in 6 s
    other = track(2, x=130.0, y=lane_centres[lane], yaw=yaw, acceleration=acceleration)
    scenario = make_scenario(track(1, x=100.0, y=lane_centres[1]), other)
    assert _counts(Situation.of(scenario.log, scenario.lane_map)) == counts


def test_too_few_moments_are_as_packaged(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0), track(2, x=130.0))
    path = str(scenario.file.recording).replace(".parquet", ".yaml")
    people = People.of([path])
    assert people.habits["lane_change_s"] == People.load().habits["lane_change_s"]
    with pytest.raises(InputError, match="no such scenario"):
        People.of(["nowhere"])
