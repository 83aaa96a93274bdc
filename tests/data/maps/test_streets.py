"""Streets fitted to NGSIM's urban columns, on tracks that are generated over a known street."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest

import made_ngsim
from litsim_data.cli import main
from litsim_data.maps.check import load_warnings
from litsim_data.maps.connectivity import connectivity
from litsim_data.maps.intersections import fit_streets
from litsim_data.maps.lane_graph import LaneGraph, Lanelet
from litsim_data.maps.net_builder import write_graph
from litsim_data.maps.netconvert import find_netconvert
from litsim_data.maps.placement import placement
from litsim_data.ngsim.sites import FOOT, SITES
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap

CROSSINGS = {1: -100.0, 2: 100.0}  # x of intersections on a street along x
HALF = 15.0  # of an intersection's square
BAY = 40.0  # length of the left-turn bays
OFFSETS = {11: 1.6, 1: 4.9, 2: 8.3}  # of lanes to the right of the middle of the street
SIDE = 1.8
REACH, SIDE_REACH = 260.0, 60.0
EAST, NORTH, WEST, SOUTH = 1, 2, 3, 4
THROUGH, LEFT, RIGHT = 1, 2, 3  # values of column Movement


def arc(start: np.ndarray, end: np.ndarray, leaving: np.ndarray, arriving: np.ndarray) -> np.ndarray:
    t = np.linspace(0.0, 1.0, 30)[:, None]
    pull = 0.6 * np.hypot(*(end - start))
    one, two = start + pull * leaving, end - pull * arriving
    return (1 - t) ** 3 * start + 3 * (1 - t) ** 2 * t * one + 3 * (1 - t) * t**2 * two + t**3 * end


def main_point(x: float, lane: int, sign: int) -> np.ndarray:
    return np.array([x, -sign * OFFSETS[lane]])


def side_point(x: float, y: float, sign: int) -> np.ndarray:
    return np.array([x + sign * SIDE, y])


def ways() -> list[tuple[int, np.ndarray]]:
    """(movement, polyline) of every movement, each at one intersection."""
    found = []
    for sign in (1, -1):
        way = np.array([float(sign), 0.0])
        found += [
            (THROUGH, np.array([main_point(-sign * REACH, lane, sign), main_point(sign * REACH, lane, sign)]))
            for lane in (1, 2)
        ]
        for x in CROSSINGS.values():
            bay = [x - sign * (HALF + BAY + taper) for taper in (15.0, 0.0)]
            into_bay = [main_point(bay[0], 1, sign), main_point(bay[1], 11, sign)]
            for movement, lane, lead, turned in (
                (LEFT, 11, [main_point(-sign * REACH, 1, sign), *into_bay], sign),
                (RIGHT, 2, [main_point(-sign * REACH, 2, sign)], -sign),
            ):
                out = np.array([0.0, float(turned)])
                stop, go = main_point(x - sign * HALF, lane, sign), side_point(x, turned * HALF, turned)
                end = side_point(x, turned * SIDE_REACH, turned)
                found.append((movement, np.vstack([*lead, arc(stop, go, way, out), end])))
    for sign in (1, -1):
        way = np.array([0.0, float(sign)])
        for x in CROSSINGS.values():
            begin, stop = side_point(x, -sign * SIDE_REACH, sign), side_point(x, -sign * HALF, sign)
            found.append((THROUGH, np.array([begin, side_point(x, sign * SIDE_REACH, sign)])))
            for movement, lane, turned in ((LEFT, 1, -sign), (RIGHT, 2, sign)):
                go, end = main_point(x + turned * HALF, lane, turned), main_point(turned * REACH, lane, turned)
                found.append((movement, np.vstack([begin, arc(stop, go, way, np.array([float(turned), 0.0])), end])))
    return found


def generated(seed: int = 0, copies: int = 12) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    tracks = []
    for movement, line in ways():
        s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        for _ in range(copies):
            at = np.arange(rng.uniform(0.0, 1.0), s[-1], 1.0)
            way = np.column_stack([np.interp(at, s, line[:, axis]) for axis in (0, 1)])
            step = np.gradient(way, axis=0)
            normal = np.column_stack([-step[:, 1], step[:, 0]]) / np.hypot(*step.T)[:, None]
            x, y = (way + rng.normal(0.0, 0.25) * normal + rng.normal(0.0, 0.05, way.shape)).T
            crossing = np.zeros(len(x), np.int64)
            for name, middle in CROSSINGS.items():
                crossing[np.abs(x - middle) < HALF] = name
            section = np.where(crossing > 0, 0, 1 + (x > CROSSINGS[1]) + (x > CROSSINGS[2]))
            heading = np.where(np.abs(step[:, 0]) > np.abs(step[:, 1]), np.where(step[:, 0] > 0, EAST, WEST), 0)
            heading = np.where(heading > 0, heading, np.where(step[:, 1] > 0, NORTH, SOUTH))
            offset = np.abs(way[:, 1])
            label = np.where(offset < 3.2, 11, np.where(offset < 6.6, 1, 2))
            tracks.append(
                pd.DataFrame(
                    {
                        "vehicle_id": len(tracks),
                        "frame": np.arange(len(x)),
                        "x": x,
                        "y": y,
                        "yaw": np.arctan2(step[:, 1], step[:, 0]),
                        "lane": np.where(crossing > 0, 0, label),
                        "intersection": crossing,
                        "section": section,
                        "direction": heading,
                        "movement": np.where(crossing > 0, movement, 0),
                    }
                )
            )
    return pd.concat(tracks, ignore_index=True)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return generated()


@pytest.fixture(scope="module")
def lanelets(table: pd.DataFrame) -> tuple[Lanelet, ...]:
    return fit_streets(table).lanelets


@pytest.fixture(scope="module")
def net(lanelets: tuple[Lanelet, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        find_netconvert()
    except InputError as error:
        pytest.skip(str(error))
    path = tmp_path_factory.mktemp("streets") / "streets.net.xml"
    write_graph(LaneGraph(lanelets), path)
    return path


def test_lanes_lie_where_they_were_driven(lanelets: tuple[Lanelet, ...]) -> None:
    by_section = {part.id: part for part in lanelets if part.id.startswith("s")}
    assert {name.split("p")[0] for name in by_section} >= {
        f"s{s}d{d}l{n}" for s in (1, 2, 3) for d in (1, 3) for n in (1, 2)
    }
    for name, part in by_section.items():
        lane = int(name.split("l")[1].split("p")[0])
        assert np.abs(np.abs(part.centerline[:, 1]) - OFFSETS[lane]).mean() < 0.3, name
        assert 2.7 <= part.width < 3.8


def test_turn_bays_begin_where_they_begin(lanelets: tuple[Lanelet, ...]) -> None:
    bays = [part for part in lanelets if part.id.startswith("s") and "l11p" in part.id]
    assert sorted(part.id.split("l")[0] for part in bays) == ["s1d1", "s2d1", "s2d3", "s3d3"]
    for part in bays:
        assert part.length == pytest.approx(BAY, abs=8.0)
        assert part.left_id is None and part.right_id is not None


def test_every_movement_is_found_and_no_other(lanelets: tuple[Lanelet, ...]) -> None:
    movements = [part for part in lanelets if part.junction]
    # At each: two approaches with two through lanes, left bay and right turn, two with three movements each.
    assert len(movements) == 2 * (2 * 4 + 2 * 3)
    assert {part.id.split("_")[0] for part in movements} == {"i1", "i2"}


def test_the_net_of_the_streets(net: Path, table: pd.DataFrame) -> None:
    lane_map = LaneMap.from_net(net)
    on = placement(lane_map, table.iloc[::5])
    assert on.inside > 0.99, on
    assert connectivity(lane_map).failures == []
    assert load_warnings(net) == ()
    kinds = [junction.get("type") for junction in ET.parse(net).getroot().findall("junction")]
    assert kinds.count("traffic_light") == 2


def test_movements_that_contradict_the_column_do_not_count(table: pd.DataFrame) -> None:
    wrong = table.copy()
    wrong.loc[(wrong["movement"] == LEFT), "movement"] = RIGHT
    assert sum(part.junction for part in fit_streets(wrong).lanelets) == 2 * (2 * 3 + 2 * 2)


def test_an_official_file_through_the_command(table: pd.DataFrame, lanelets: tuple[Lanelet, ...], net: Path) -> None:
    site = SITES["lankershim"]
    like = made_ngsim.table(made_ngsim.Traffic(site, "0830", rows=500)).iloc[[0]]
    made = like.loc[like.index.repeat(len(table))].reset_index(drop=True)
    x, y = made_ngsim.global_from_map(site, table["x"].to_numpy(), table["y"].to_numpy())
    made["global_x"], made["global_y"] = x / FOOT, y / FOOT
    made["time_ms"] += 100 * (table["frame"] - made["frame"])
    for name in ("vehicle_id", "frame", "lane", "intersection", "section", "direction", "movement"):
        made[name] = table[name]
    made["vehicle_id"] += 1
    source, again = net.parent / "made.csv", net.parent / "again.net.xml"
    made_ngsim.write_portal(made, source)
    main(["map", "--recording", str(source), "--out", str(again)])
    one, other = LaneMap.from_net(net), LaneMap.from_net(again)
    assert [lane.id for lane in one.lanes] == [lane.id for lane in other.lanes]
    for a, b in zip(one.lanes, other.lanes, strict=True):
        np.testing.assert_allclose(a.centerline[[0, -1]], b.centerline[[0, -1]], atol=0.02)


def test_tables_that_are_no_streets(table: pd.DataFrame) -> None:
    with pytest.raises(InputError, match=r"columns \['section'\] are missing"):
        fit_streets(table.drop(columns="section"))
    with pytest.raises(InputError, match="no row is in a section"):
        fit_streets(table.assign(section=0))
    with pytest.raises(InputError, match="no lane has"):
        fit_streets(table[table["vehicle_id"] == 0])
