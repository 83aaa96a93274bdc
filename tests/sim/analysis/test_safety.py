"""Surrogate safety measures on scenes with answers known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from litsim_sim.analysis.safety import encroachments, following, safety_series, time_to_collision

Make = Callable[..., Any]


def behind(table: Make, gap: float, speed: float, leader_speed: float, **leader: Any) -> Any:
    """Agent 1 behind agent 2, `gap` metres from bumper to bumper; both are 4 m long."""
    return table(
        0,
        {"id": 1, "x": 0.0, "y": 0.0, "speed": speed},
        {"id": 2, "x": gap + 4.0, "y": 0.0} | {"speed": leader_speed} | leader,
    )


def test_ttc_is_gap_over_closing_speed(table: Make) -> None:
    assert time_to_collision(behind(table, 9.75, 15.0, 10.0), 0) == pytest.approx(2.0, abs=0.051)


@pytest.mark.parametrize(
    "scene",
    [
        {"gap": 10.0, "speed": 10.0, "leader_speed": 10.0},  # not closing in
        {"gap": 10.0, "speed": 10.0, "leader_speed": 12.0},  # opening
        {"gap": 40.0, "speed": 20.0, "leader_speed": 10.0},  # in 4 s, beyond the horizon
        {"gap": 10.0, "speed": 20.0, "leader_speed": 5.0, "y": 3.5},  # in the next lane
    ],
)
def test_no_ttc(table: Make, scene: dict[str, Any]) -> None:
    assert time_to_collision(behind(table, **scene), 0) == float("inf")


def test_ttc_in_contact_is_zero_and_being_run_into_is_not_ones_own(table: Make) -> None:
    assert time_to_collision(behind(table, -1.0, 10.0, 10.0), 0) == 0.0
    assert time_to_collision(behind(table, 5.0, 15.0, 10.0), 1) == float("inf")


def test_ttc_of_a_crossing(table: Make) -> None:
    crossing = table(0, {"id": 1, "x": -20.0, "y": 0.0}, {"id": 2, "x": 0.0, "y": -20.0, "yaw": 1.5707963})
    # fronts reach the other's flank 3 m before the crossing point: 20 - 2 - 1 = 17 m at 10 m/s
    assert time_to_collision(crossing, 0) == pytest.approx(1.75, abs=0.06)


def test_headway_and_drac(table: Make) -> None:
    headway, drac = following(behind(table, 20.0, 10.0, 5.0), 0)
    assert headway == pytest.approx(2.0)
    assert drac == pytest.approx(25.0 / 40.0)


def test_nearest_of_two_leaders_counts_and_neighbours_do_not(table: Make) -> None:
    scene = table(
        0,
        {"id": 1, "x": 0.0, "y": 0.0},
        {"id": 2, "x": 54.0, "y": 0.0},
        {"id": 3, "x": 24.0, "y": 0.0},
        {"id": 4, "x": 9.0, "y": 3.5},
    )
    assert following(scene, 0) == (pytest.approx(2.0), 0.0)
    assert following(scene, 1) == (float("inf"), 0.0)  # nobody ahead


def test_series_covers_the_steps_on_the_road(table: Make) -> None:
    tables = [
        table(k, *([{"id": 1, "x": 1.0 * k, "y": 0.0}] if k >= 2 else []), {"id": 2, "x": 50.0, "y": 0.0, "speed": 0.0})
        for k in range(5)
    ]
    series = safety_series(tables, 1)
    assert series.step.tolist() == [2, 3, 4]
    assert (series.headway[1:] < series.headway[:-1]).all()


def test_pet_of_a_crossing(table: Make) -> None:
    # 1 is at the origin at step 20, 2 crosses it 1.5 s later; boxes 4 x 2 m at 10 m/s
    tables = [
        table(k, {"id": 1, "x": k - 20.0, "y": 0.0}, {"id": 2, "x": 0.0, "y": k - 35.0, "yaw": 1.5707963})
        for k in range(60)
    ]
    (found,) = encroachments(tables, 1)
    # the rear of 1 is past the flank of 2 when 1 is 3 m on, the front of 2 is at the flank of 1 3 m before: 1.5 - 0.6 s
    assert found.pet == pytest.approx(0.9, abs=0.21)
    assert (found.agent, found.first) == (2, 1)
    assert encroachments(tables, 2)[0].first == 1


def test_no_pet_in_parallel_lanes_or_much_later(table: Make) -> None:
    parallel = [table(k, {"id": 1, "x": 1.0 * k, "y": 0.0}, {"id": 2, "x": 1.0 * k, "y": 3.5}) for k in range(30)]
    assert encroachments(parallel, 1) == []
    late = [
        table(k, {"id": 1, "x": k - 20.0, "y": 0.0}, {"id": 2, "x": 0.0, "y": k - 90.0, "yaw": 1.5707963})
        for k in range(100)
    ]
    assert encroachments(late, 1) == []
