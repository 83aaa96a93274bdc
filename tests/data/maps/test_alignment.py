"""The shift and turn by which tracks were moved off their net are found again, and a turn is explained."""

import math

import numpy as np
import pandas as pd
import pytest

from litsim_data.maps import alignment
from litsim_data.maps.alignment import Alignment, align, explained, grid_convergence
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged

STREET = LaneMap.from_net(packaged("nets/urban_like.net.xml"))


def on_lanes(lane_map: LaneMap, bounds: float) -> pd.DataFrame:
    """Positions on the centre lines, every 3 m, within `bounds` of the origin."""
    parts = []
    for row, lane in enumerate(lane_map.lanes):
        x, y, yaw = lane_map.pose_at(row, np.arange(0.0, lane.length, 3.0))
        parts.append(pd.DataFrame({"x": x, "y": y, "yaw": yaw}))
    table = pd.concat(parts, ignore_index=True)
    return table[(table["x"].abs() < bounds) & (table["y"].abs() < bounds)]


def moved(table: pd.DataFrame, turn: float, x: float, y: float) -> pd.DataFrame:
    cos, sin = math.cos(turn), math.sin(turn)
    return table.assign(
        x=cos * table["x"] - sin * table["y"] + x, y=sin * table["x"] + cos * table["y"] + y, yaw=table["yaw"] + turn
    )


@pytest.mark.parametrize(
    ("turn_deg", "x", "y"), [(0.0, 0.0, 0.0), (1.4, 2.0, -3.0), (-2.5, -6.0, 5.0), (0.0, 8.0, 3.0)]
)
def test_the_motion_is_found(turn_deg: float, x: float, y: float) -> None:
    table = on_lanes(STREET, 200.0)
    found = align(STREET, moved(table, math.radians(turn_deg), x, y))
    assert found.determined and found.after > 0.99
    assert found.in_place == (turn_deg == x == y == 0.0)
    assert math.degrees(found.turn) == pytest.approx(-turn_deg, abs=0.03)
    back = found.apply(*(moved(table, math.radians(turn_deg), x, y)[axis].to_numpy() for axis in "xy"))
    np.testing.assert_allclose(np.column_stack(back), table[["x", "y"]], atol=0.1)
    mended = found.transform(yaw_deg=turn_deg, x=x, y=y)
    np.testing.assert_allclose(mended, 0.0, atol=0.1)


def test_the_transform_holds_as_it_is_written_for_tracks_in_utm() -> None:
    """Three decimals of an angle are 100 m at a northing of 5800 km: x and y go with the angle that is written."""
    found = Alignment(
        (10.0, -20.0), (0.9, -1.7), math.radians(-1.31046), 0.8, 1.0, determined=True, net_centre=(0.0, 0.0)
    )
    place, before = np.array([619_030.0, 5_809_040.0]), np.array([-619_000.0, -5_809_000.0])
    yaw_deg, x, y = found.transform(0.0, *before)
    assert yaw_deg == round(yaw_deg, 3)
    turn = math.radians(yaw_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    there = cos * place[0] - sin * place[1] + x, sin * place[0] + cos * place[1] + y
    expected = np.ravel(found.apply(*(place + before).reshape(2, 1)))
    np.testing.assert_allclose(there, expected, atol=0.01)


def test_a_straight_road_does_not_tell_how_far_along_it() -> None:
    road = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    table = on_lanes(road, 640.0)
    found = align(road, moved(table[table["y"] > -18.0], 0.0, 5.0, 1.2))
    assert not found.determined
    assert found.shift == (pytest.approx(0.0, abs=0.05), pytest.approx(-1.2, abs=0.05))


@pytest.mark.parametrize(
    ("latitude", "longitude", "degrees"),
    [
        (49.0, 9.0, 0.0),
        (49.0, 10.85, 1.3963),
        (49.0, 7.15, -1.3963),
        (-49.0, 10.85, -1.3963),
        (0.0, 10.0, 0.0),
        (60.0, -75.5, -0.433),
    ],
)
def test_grid_convergence(latitude: float, longitude: float, degrees: float) -> None:
    assert math.degrees(grid_convergence(latitude, longitude)) == pytest.approx(degrees, abs=0.001)


def test_what_a_turn_comes_from() -> None:
    site = (49.0, 10.85)
    assert "the net is in UTM, the tracks are along true north" in explained(math.radians(1.4), site)
    assert "the tracks are in UTM, the net is along true north" in explained(math.radians(-1.35), site)
    assert "does not explain the turn" in explained(math.radians(0.7), site)
    assert "--origin LAT LON" in explained(math.radians(1.4), None)
    assert explained(math.radians(0.05), site) == explained(math.radians(12.0), site) == ""


def test_tracks_in_another_country_are_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their motion is not looked for: with thousands of starts that took minutes."""
    monkeypatch.setattr(alignment, "_descended", None)
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    far = pd.DataFrame({"x": np.linspace(1.5e7, 1.5e7 + 400.0, 50), "y": -5.0, "yaw": 0.0})
    found = align(lane_map, far)
    assert found.lost and found.shift == (0.0, 0.0) and found.net_centre == pytest.approx((320.0, -15.0), abs=30.0)
