"""The careful driver of R157 in scenes that he can and cannot manage."""

from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.careful_driver import (
    BRAKE_JERK,
    BRAKE_MAX,
    REACTION_S,
    WANDERING,
    careful_driver,
    speed_lost,
)
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged
from made_runs import table


def approach(distance: float, speed: float, steps: int) -> list[Any]:
    """Ego 1 drives at constant speed into agent 2, which stands with its centre `distance` ahead."""
    return [
        table(
            k,
            {"id": 1, "x": 0.1 * speed * k, "y": 0.0, "speed": speed},
            {"id": 2, "x": distance, "y": 0.0, "speed": 0.0},
        )
        for k in range(steps)
    ]


def contact(tables: list[Any], distance: float) -> int:
    return next(t.step for t in tables if distance - t.x[0] < 4.0)


def test_one_that_appears_right_ahead_cannot_be_avoided() -> None:
    tables = [
        table(k, {"id": 1, "x": 1.0 * k, "y": 0.0}, {"id": 2, "x": 56.0, "y": 0.0 if k >= 48 else 20.0, "speed": 0.0})
        for k in range(80)
    ]
    found = careful_driver(tables, 1, 2, contact([t for t in tables if t.step >= 48], 56.0), 0.1, None)
    assert (found.perceived_step, found.avoided) == (48, False)


def test_the_driver_brakes_neither_sooner_nor_harder_than_the_regulation_says() -> None:
    """The speed that is lost is the integral of a braking that grows from 0.75 s on, in 0.6 s, to 0.774 g."""
    times = np.linspace(0.0, 4.0, 40_001)
    braking = np.clip(BRAKE_JERK * (times - REACTION_S), 0.0, BRAKE_MAX)
    lost = np.concatenate([[0.0], np.cumsum(0.5 * (braking[1:] + braking[:-1]) * np.diff(times))])
    assert [speed_lost(time) for time in times[::500]] == pytest.approx(lost[::500].tolist(), abs=1e-6)


def test_one_is_met_that_is_just_too_near_to_stop_behind() -> None:
    """At 10 m/s he stops within 17.0 m: 7.5 m while he reacts, 5.5 m while his braking grows, 3.9 m at its most.

    Whoever stands there is a risk from the first step on, at which less than 2 s are left.
    """
    found = []
    for room in (16.5, 17.5):  # [m] between the bumpers at that step
        tables = approach(room + 4.0, 10.0, steps=40)
        found.append(careful_driver(tables, 1, 2, contact(tables, room + 4.0), 0.1, None).avoided)
    assert found == [False, True]


@pytest.mark.parametrize(("distance", "speed", "avoided"), [(80.0, 10.0, True), (150.0, 30.0, False)])
def test_the_end_of_the_run_is_no_way_out(distance: float, speed: float, avoided: bool) -> None:
    """The verdict on a contact that ends the run is that on one after which the run goes on."""
    tables = approach(distance, speed, steps=120)
    hit = contact(tables, distance)
    whole = careful_driver(tables, 1, 2, hit, 0.1, None)
    assert whole.avoided == avoided
    for last in (hit, hit + 1, hit + 29, hit + 35):
        assert careful_driver(tables[: last + 1], 1, 2, hit, 0.1, None) == whole


LANES = (-1.83, -5.49, -9.15)  # [m] centres of the leftmost lanes of us101_like
DRIFT = 0.1  # [m] to the side in a step


def cut_in(ego_lane: float, begins: int = 10) -> list[Any]:
    """Agent 2, 5 m/s slower and 25 m ahead of ego 1, leaves the middle lane to the left from a step on to the next."""
    tables = []
    for k in range(100):
        y = min(LANES[1] + DRIFT * max(0, k - begins), LANES[0])
        ego = {"id": 1, "x": 100.0 + 1.5 * k, "y": ego_lane, "speed": 15.0}
        tables.append(table(k, ego, {"id": 2, "x": 125.0 + 1.0 * k, "y": y, "speed": 10.0}))
    return tables


def contact_step(tables: list[Any]) -> int:
    """First step at which the two boxes overlap; they are parallel and of one size."""
    return next(t.step for t in tables if abs(t.x[1] - t.x[0]) < t.length[0] and abs(t.y[1] - t.y[0]) < t.width[0])


def test_a_cut_in_is_seen_by_its_wandering_before_it_is_in_the_way() -> None:
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    tables = cut_in(LANES[0])
    hit = contact_step(tables)
    found = careful_driver(tables, 1, 2, hit, 0.1, lane_map)
    assert found.perceived_step == 10 + int(WANDERING / DRIFT) + 1  # the first step beyond it
    assert found.avoided
    late = careful_driver(tables, 1, 2, hit, 0.1, None)  # without lanes, only once it is straight ahead
    assert late.perceived_step > found.perceived_step
    close = cut_in(LANES[0], begins=28)
    assert not careful_driver(close, 1, 2, contact_step(close), 0.1, lane_map).avoided


def test_wandering_away_from_the_ego_is_no_risk() -> None:
    """Nor is, two lanes further on, where it then is in its new lane."""
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    tables = cut_in(LANES[2])
    found = careful_driver(tables, 1, 2, 60, 0.1, lane_map)
    assert found.perceived_step == 60  # nothing announced whatever it was
    assert found.avoided
