"""Surrogate safety measures on scenes with answers known in closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapely

from litsim_data.surrogates.safety import SIGHT_M, following, safety_series, shortest_own_ttc, times_to_collision
from litsim_eval.analysis.measures.motion_features import _distance_to_nearest
from litsim_sim.core import nearby
from litsim_sim.core.geometry import box_corners, to_body
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentTable

Make = Callable[..., Any]


def time_to_collision(table: Any, row: int) -> float:
    (ttc,) = times_to_collision(table, np.array([row]))
    return float(ttc)


def behind(table: Make, gap: float, speed: float, leader_speed: float, **leader: Any) -> Any:
    """Agent 1 behind agent 2, `gap` metres from bumper to bumper; both are 4 m long."""
    return table(
        0,
        {"id": 1, "x": 0.0, "y": 0.0, "speed": speed},
        {"id": 2, "x": gap + 4.0, "y": 0.0} | {"speed": leader_speed} | leader,
    )


@pytest.mark.parametrize("across", [0, 1])
@pytest.mark.parametrize("seed", range(4))
def test_sorted_by_place_the_results_are_those_of_a_look_at_all(
    monkeypatch: pytest.MonkeyPatch, seed: int, across: int
) -> None:
    random, count = np.random.default_rng(seed), 160
    places = [random.uniform(0.0, 600.0, count), 3.5 * random.integers(0, 3, count)]
    columns = {name: np.zeros(count) for name in ARRAY_FIELDS}
    columns |= {"id": np.arange(count), "x": places[across], "y": places[1 - across]}
    columns |= {"yaw": random.normal(0.5 * np.pi * across, 0.1, count), "speed": random.uniform(0.0, 30.0, count)}
    columns |= {"length": random.choice([4.0, 12.0], count), "width": np.full(count, 1.8)}
    table = AgentTable(0, **{name: values.astype(DTYPES[name]) for name, values in columns.items()})
    table.x[7] = table.speed[9] = np.nan
    rows = np.arange(0, count, 1 + seed % 2)
    results = []
    for few in (0, count):
        monkeypatch.setattr(nearby, "FEW", few)
        front = following(table, rows)
        results.append([times_to_collision(table, rows), front.leader, front.gap, _distance_to_nearest(table, rows)])
    for fast, plain in zip(*results, strict=True):
        assert np.array_equal(fast, plain, equal_nan=True)
    apart = np.hypot(table.x - table.x[4], table.y - table.y[4])
    apart[[4, 7]] = np.inf
    nearest = int(np.argmin(apart))
    expected = apart[nearest] - 0.5 * (table.length[4] + table.length[nearest])
    assert _distance_to_nearest(table, np.array([4])) == expected
    assert (results[0][1] >= 0).any() and np.isfinite(results[0][0]).any()


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


def test_own_ttc_leaves_out_who_was_touched_from_then_on(table: Make) -> None:
    """Agent 2 comes from behind, touches agent 1 at step 1, and overlaps its front at step 2; agent 3 stands ahead."""
    scenes = [
        table(
            step,
            {"id": 1, "x": 0.0, "y": 0.0},
            {"id": 2, "x": x, "y": 0.0},
            {"id": 3, "x": 4.0 + gap, "y": 0.0, "speed": 0.0},
        )
        for step, (x, gap) in enumerate(((-5.0, 28.5), (-3.0, 24.5), (2.0, 19.5)))
    ]
    assert shortest_own_ttc(scenes, 1, {2: 1}) == pytest.approx(2.0, abs=0.06)
    assert shortest_own_ttc(scenes, 1, {2: 2}) == 0.0, "until then it counts"
    assert shortest_own_ttc(scenes[:1], 1, {}) == pytest.approx(2.9, abs=0.06)
    assert shortest_own_ttc(scenes, 4, {}) == float("inf")


def test_headway_and_drac(table: Make) -> None:
    found = following(behind(table, 20.0, 10.0, 5.0), np.array([0, 1]))
    assert found.leader.tolist() == [1, -1]
    assert found.gap.tolist() == [pytest.approx(20.0), np.inf]
    assert found.closing.tolist() == [5.0, 0.0]
    assert found.headway.tolist() == [pytest.approx(2.0), np.inf]
    assert found.drac.tolist() == [pytest.approx(25.0 / 40.0), 0.0]
    assert found.time_to_leader.tolist() == [pytest.approx(4.0), np.inf]


def test_leader_in_contact(table: Make) -> None:
    found = following(behind(table, -1.0, 10.0, 5.0), np.array([0]))
    assert (found.gap[0], found.headway[0], found.drac[0], found.time_to_leader[0]) == (0.0, 0.0, np.inf, 0.0)
    found = following(behind(table, -1.0, 5.0, 5.0), np.array([0]))
    assert (found.gap[0], found.drac[0], found.time_to_leader[0]) == (0.0, 0.0, np.inf)


def test_gaps_are_those_of_polygons(table: Make) -> None:
    """Random boxes against the intersection of polygons with the strip."""
    random = np.random.default_rng(11)
    low, high = (-60.0, -12.0, -3.2, 0.4, 0.3), (90.0, 12.0, 3.2, 14.0, 3.0)
    columns = ("x", "y", "yaw", "length", "width")
    found = 0
    for _ in range(20):
        rows = random.uniform(low, high, (12, 5)).tolist()
        scene = table(0, *({"id": i} | dict(zip(columns, row, strict=True)) for i, row in enumerate(rows)))
        corners = box_corners(scene.x, scene.y, scene.yaw, scene.length, scene.width)
        measured = following(scene, np.arange(12))
        for k in range(12):
            ahead, left = to_body(corners[..., 0] - scene.x[k], corners[..., 1] - scene.y[k], scene.yaw[k])
            strip = shapely.box(-200.0, -scene.width[k] / 2, 200.0, scene.width[k] / 2)
            places = [shapely.Polygon(box).intersection(strip) for box in np.stack([ahead, left], axis=-1)]
            centre, _ = to_body(scene.x - scene.x[k], scene.y - scene.y[k], scene.yaw[k])
            back = -scene.length[k] / 2
            leads = [place.area > 0.0 and place.bounds[2] > back and centre[i] > 0.0 for i, place in enumerate(places)]
            gaps = [place.bounds[0] + back if leads[i] and i != k else np.inf for i, place in enumerate(places)]
            gap = min(gaps) if min(gaps) < SIGHT_M else np.inf
            assert measured.gap[k] == pytest.approx(max(gap, 0.0), abs=1e-9)
            assert measured.leader[k] == (int(np.argmin(gaps)) if np.isfinite(gap) else -1)
            found += np.isfinite(gap)
    assert found > 50


def test_series_covers_the_steps_on_the_road(table: Make) -> None:
    tables = [
        table(k, *([{"id": 1, "x": 1.0 * k, "y": 0.0}] if k >= 2 else []), {"id": 2, "x": 50.0, "y": 0.0, "speed": 0.0})
        for k in range(5)
    ]
    series = safety_series(tables, 1)
    assert series.step.tolist() == [2, 3, 4]
    assert (series.headway[1:] < series.headway[:-1]).all()
