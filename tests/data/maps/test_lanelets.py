"""Lanelet maps as nets: by hand, from CommonRoad, Lanelet2 and OpenDRIVE files that the tests write."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from litsim_data.cli import main
from litsim_data.maps import lanelet2_osm
from litsim_data.maps.check import check_net
from litsim_data.maps.commonroad import read_lanelets
from litsim_data.maps.lanelets import Lanelet, lanelets_plain_xml, write_lanelets
from litsim_data.maps.netconvert import find_netconvert, import_opendrive
from litsim_data.maps.positions import for_checking
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap

WIDTH = 3.5


@pytest.fixture(autouse=True, scope="module")
def netconvert() -> None:
    try:
        find_netconvert()
    except InputError as error:
        pytest.skip(str(error))


def straight(name: str, start: tuple[float, float], end: tuple[float, float], *successors: str) -> Lanelet:
    line = np.array([start, end])
    along = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
    left = 0.5 * WIDTH * np.array([-along[1], along[0]])
    return Lanelet(name, line + left, line - left, successors)


def crossing() -> list[Lanelet]:
    """A two-lane road to the east that a lane to the north crosses; from the latter one can turn right."""
    right, left = (-1.75, 1.75)
    lanes = [
        straight("right_in", (-60, right), (-10, right), "right_over"),
        straight("left_in", (-60, left), (-10, left), "left_over"),
        straight("right_over", (-10, right), (10, right), "right_out"),
        straight("left_over", (-10, left), (10, left), "left_out"),
        straight("right_out", (10, right), (60, right)),
        straight("left_out", (10, left), (60, left)),
        straight("north_in", (0, -60), (0, -10), "north_over", "turn"),
        straight("north_over", (0, -10), (0, 10), "north_out"),
        straight("north_out", (0, 10), (0, 60)),
        straight("turn", (0, -10), (10, right), "right_out"),
    ]
    for at in (0, 2, 4):
        lanes[at] = replace(lanes[at], left_id=lanes[at + 1].id)
        lanes[at + 1] = replace(lanes[at + 1], right_id=lanes[at].id)
    return lanes


def by_place(lane_map: LaneMap, x: float, y: float) -> str:
    at = lane_map.nearest(np.array([x]), np.array([y]))
    return lane_map.lanes[at.lane[0]].id


# Lanelets to nets


def test_crossing_lanelets_become_one_junction(tmp_path: Path) -> None:
    net = tmp_path / "made.net.xml"
    assert write_lanelets(crossing(), net) == []
    lane_map = LaneMap.from_net(net)
    outer = {lane.id: lane for lane in lane_map.lanes if not lane.is_internal}
    assert set(outer) == {"right_in_0", "right_in_1", "right_out_0", "right_out_1", "north_in_0", "north_out_0"}
    assert outer["right_in_1"].right == "right_in_0"
    np.testing.assert_allclose(outer["right_in_1"].centerline[[0, -1]], [[-60, 1.75], [-10, 1.75]], atol=2e-3)
    assert outer["right_in_0"].width == pytest.approx(WIDTH)
    assert len(outer["north_in_0"].successors) == 2
    assert by_place(lane_map, 0.0, 1.75).startswith(":")
    kinds = [junction.get("type") for junction in ET.parse(net).getroot().findall("junction")]
    assert kinds.count("dead_end") == 4 and kinds.count("priority") == 1
    assert check_net(net, {}).failures == []


def test_signals_make_a_signalised_junction(tmp_path: Path) -> None:
    lanes = [replace(lanelet, signal=lanelet.id == "north_in") for lanelet in crossing()]
    write_lanelets(lanes, tmp_path / "made.net.xml")
    assert 'type="traffic_light"' in (tmp_path / "made.net.xml").read_text()


def test_lanelets_one_after_the_other_need_no_turn(tmp_path: Path) -> None:
    write_lanelets([straight("a", (0, 0), (50, 0), "b"), straight("b", (50, 0), (90, 0))], tmp_path / "made.net.xml")
    lane_map = LaneMap.from_net(tmp_path / "made.net.xml")
    path = lane_map.path_from(lane_map.row("a_0"), 0.0, 90.0)
    np.testing.assert_allclose(path[:, 1], 0.0, atol=2e-3)
    assert path[-1, 0] == pytest.approx(90.0, abs=0.02)


def test_lanelets_that_no_road_is_long_enough_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lanelet far is 1e\\+06 km long, expected at most 100"):
        write_lanelets(
            [straight("a", (0, 0), (50, 0), "far"), straight("far", (50, 0), (1e9, 0))], tmp_path / "n.net.xml"
        )


def test_no_lanelets() -> None:
    with pytest.raises(InputError, match="holds no lanelets"):
        lanelets_plain_xml([])


# CommonRoad


def write_commonroad(lanelets: list[Lanelet], path: Path) -> None:
    root = ET.Element("commonRoad", {"commonRoadVersion": "2020a"})
    numbers = {lanelet.id: str(100 + i) for i, lanelet in enumerate(lanelets)}
    for lanelet in lanelets:
        element = ET.SubElement(root, "lanelet", {"id": numbers[lanelet.id]})
        for name, bound in (("leftBound", lanelet.left), ("rightBound", lanelet.right)):
            parent = ET.SubElement(element, name)
            for point in bound:
                child = ET.SubElement(parent, "point")
                ET.SubElement(child, "x").text, ET.SubElement(child, "y").text = (f"{v:.4f}" for v in point)
        for other in lanelet.successors:
            ET.SubElement(element, "successor", {"ref": numbers[other]})
        for name, neighbour in (("adjacentLeft", lanelet.left_id), ("adjacentRight", lanelet.right_id)):
            if neighbour:
                ET.SubElement(element, name, {"ref": numbers[neighbour], "drivingDir": "same"})
        if lanelet.id == "right_in":
            ET.SubElement(element, "trafficSignRef", {"ref": "7"})
    sign = ET.SubElement(root, "trafficSign", {"id": "7"})
    ET.SubElement(ET.SubElement(sign, "trafficSignElement"), "additionalValue").text = "15.6"
    ET.ElementTree(root).write(path)


def test_commonroad_through_the_command(tmp_path: Path) -> None:
    source, net = tmp_path / "map.xml", tmp_path / "map.net.xml"
    write_commonroad(crossing(), source)
    main(["map", "--commonroad", str(source), "--out", str(net)])
    lane_map = LaneMap.from_net(net)
    assert sum(not lane.is_internal for lane in lane_map.lanes) == 6
    assert lane_map.lanes[lane_map.row("100_0")].speed_limit == pytest.approx(15.6)


def test_files_that_are_no_commonroad_maps(tmp_path: Path) -> None:
    bad = tmp_path / "bad.xml"
    for text, message in (
        ("no XML", "not a readable CommonRoad file"),
        ("<osm/>", "its root element is <osm>"),
        ("<commonRoad/>", "no lanelets"),
        ('<commonRoad><lanelet id="5"/></commonRoad>', "lanelet 5: leftBound has 0 points"),
    ):
        bad.write_text(text)
        with pytest.raises(InputError, match=message):
            read_lanelets(bad)
    with pytest.raises(InputError, match="not a readable CommonRoad file"):
        read_lanelets(tmp_path / "absent.xml")


@pytest.mark.data
@pytest.mark.parametrize(
    ("street", "name", "share"),
    [
        ("lankershim", "USA_Lanker-1_2", 0.99),
        ("lankershim", "USA_Lanker-2_25", 0.99),
        ("peachtree", "USA_Peach-2_1", 0.985),  # the map's own lanelets hold 99.0 % of them
        ("peachtree", "USA_Peach-3_1", 0.99),
        ("peachtree", "USA_Peach-4_2", 0.99),
    ],
)
def test_real_lanelet_maps_hold_the_vehicles_of_their_windows(
    street: str, name: str, share: float, tmp_path: Path
) -> None:
    folder = os.environ.get("LITSIM_DATA")
    if not folder:
        pytest.skip("LITSIM_DATA names no folder of real data")
    net = tmp_path / "made.net.xml"
    source = Path(folder) / "maps" / "commonroad" / f"{name}_map.xml"
    windows = Path(folder) / "ngsim" / f"{street}_commonroad_windows.parquet"
    if not source.is_file() or not windows.is_file():
        pytest.skip(f"{source} or {windows} is not there")
    lanelets = read_lanelets(source)
    write_lanelets(lanelets, net)
    lane_map = LaneMap.from_net(net)
    ends = np.array([lanelet.centerline[at] for lanelet in lanelets for at in (0, -1)])
    for lane in lane_map.lanes:  # netconvert has neither cut nor lengthened a lane
        if not lane.is_internal:
            for point in lane.centerline[[0, -1]]:
                assert np.hypot(*(ends - point).T).min() < 0.005, lane.id
    checked = check_net(net, for_checking(windows, [name]))
    assert checked.placements[name].inside >= share
    assert checked.warnings == ()
    # Two lanelets of that map lie across its junction and lead nowhere.
    crossing = [("43620", "43634")] if name == "USA_Peach-4_2" else []
    assert [(each.one, each.other) for each in checked.connectivity.crossings] == crossing
    assert len(checked.connectivity.failures) == len(crossing)


# Lanelet2

OSM = """<osm version="0.6">
{nodes}
  <way id="21"><nd ref="1"/><nd ref="2"/><tag k="type" v="line_thin"/><tag k="subtype" v="solid"/></way>
  <way id="22"><nd ref="3"/><nd ref="4"/><tag k="type" v="line_thin"/><tag k="subtype" v="dashed"/></way>
  <way id="23"><nd ref="5"/><nd ref="6"/><tag k="type" v="line_thin"/><tag k="subtype" v="solid"/></way>
  <way id="24"><nd ref="2"/><nd ref="7"/><tag k="type" v="line_thin"/><tag k="subtype" v="solid"/></way>
  <way id="25"><nd ref="4"/><nd ref="8"/><tag k="type" v="line_thin"/><tag k="subtype" v="dashed"/></way>
{relations}
</osm>"""
RELATION = (
    '<relation id="{id}"><member type="way" ref="{left}" role="left"/><member type="way" ref="{right}" role="right"/>'
    '<tag k="type" v="lanelet"/><tag k="subtype" v="road"/><tag k="location" v="urban"/><tag k="one_way" v="yes"/>'
    '<tag k="participant:vehicle" v="yes"/><tag k="speed_limit" v="36 km/h"/></relation>'
)


def write_osm(path: Path) -> None:
    """Two lanes to the north of 100 m from (49 N, 8.4 E), the left one going on for 50 m."""
    lat, lon = 1.0 / 111_213.0, 1.0 / 73_170.0  # degrees a metre there
    places = {
        1: (-3.5, 0),
        2: (-3.5, 100),
        3: (0, 0),
        4: (0, 100),
        5: (3.5, 0),
        6: (3.5, 100),
        7: (-3.5, 150),
        8: (0, 150),
    }
    nodes = [f'  <node id="{i}" lat="{49 + y * lat:.9f}" lon="{8.4 + x * lon:.9f}"/>' for i, (x, y) in places.items()]
    lanes = ((31, 21, 22), (32, 22, 23), (33, 24, 25))
    relations = [RELATION.format(id=i, left=left, right=right) for i, left, right in lanes]
    path.write_text(OSM.format(nodes="\n".join(nodes), relations="\n".join(relations)))


def test_lanelet2_through_the_command(tmp_path: Path) -> None:
    pytest.importorskip("lanelet2", reason="the lanelet2 package is not installed: requirements/maps.txt")
    write_osm(tmp_path / "map.osm")
    net = tmp_path / "map.net.xml"
    main(["map", "--lanelet2", str(tmp_path / "map.osm"), "--origin", "49.0", "8.4", "--out", str(net)])
    lanes = {lane.id: lane for lane in LaneMap.from_net(net).lanes if not lane.is_internal}
    assert set(lanes) == {"32_0", "32_1", "33_0"}
    assert lanes["32_1"].length == pytest.approx(100.0, abs=0.3)
    assert lanes["32_1"].width == pytest.approx(3.5, abs=0.05)
    assert lanes["32_1"].speed_limit == pytest.approx(10.0, abs=0.01)
    assert len(lanes["32_1"].successors) == 1 and lanes["32_0"].successors == ()
    np.testing.assert_allclose(lanes["32_1"].centerline[0], [-1.75, 0.0], atol=0.1)


def test_an_origin_far_from_the_map_is_told_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("lanelet2", reason="the lanelet2 package is not installed: requirements/maps.txt")
    write_osm(tmp_path / "map.osm")
    with pytest.raises(SystemExit, match="2"):
        main(["map", "--lanelet2", str(tmp_path / "map.osm"), "--origin", "8.4", "49.0", "--out", str(tmp_path / "n")])
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("error: ") and "out of legal range for UTM zone" in said and "more such lines" in said
    assert said.endswith("is --origin 8.4 49, latitude and longitude, near the map?")


def test_lanelet2_without_the_package_or_an_origin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_osm(tmp_path / "map.osm")
    command = ["map", "--lanelet2", str(tmp_path / "map.osm"), "--out", str(tmp_path / "map.net.xml")]
    with pytest.raises(SystemExit, match="2"):
        main(command)
    assert "needs --origin LAT LON" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "lanelet2.core", None)
    with pytest.raises(SystemExit, match="2"):
        main([*command, "--origin", "49.0", "8.4"])
    assert "lanelet2 is not installed here, and this needs it: `make setup-all`" in capsys.readouterr().err


# OpenDRIVE

LANE = '<lane id="{id}" type="driving" level="false"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
XODR = f"""<?xml version="1.0"?>
<OpenDRIVE><header revMajor="1" revMinor="4" name="" version="1" date="" north="0" south="0" east="0" west="0"/>
<road name="" length="120" id="1" junction="-1"><link/><planView>
<geometry s="0" x="5" y="7" hdg="0" length="120"><line/></geometry></planView>
<lanes><laneSection s="0"><center><lane id="0" type="none" level="false"/></center>
<right>{LANE.format(id=-1)}{LANE.format(id=-2)}</right></laneSection></lanes></road></OpenDRIVE>"""


def test_opendrive_through_the_command(tmp_path: Path) -> None:
    (tmp_path / "map.xodr").write_text(XODR)
    net = tmp_path / "map.net.xml"
    main(["map", "--opendrive", str(tmp_path / "map.xodr"), "--out", str(net)])
    lane_map = LaneMap.from_net(net)
    assert [lane.width for lane in lane_map.lanes] == pytest.approx([3.5, 3.5])
    left, right = sorted(lane_map.lanes, key=lambda lane: -lane.centerline[0, 1])
    np.testing.assert_allclose(left.centerline[[0, -1]], [[5.0, 5.25], [125.0, 5.25]], atol=0.02)
    assert right.left == left.id


def test_opendrive_that_is_missing_or_malformed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such OpenDRIVE file"):
        import_opendrive(tmp_path / "absent.xodr", tmp_path / "a.net.xml")
    (tmp_path / "bad.xodr").write_text("no XML")
    with pytest.raises(InputError, match=r"netconvert refused .*bad\.xodr: [^\n]+$"):
        import_opendrive(tmp_path / "bad.xodr", tmp_path / "a.net.xml")


def test_opendrive_of_left_hand_traffic_is_refused(tmp_path: Path) -> None:
    (tmp_path / "left.xodr").write_text(XODR.replace('junction="-1"', 'junction="-1" rule="LHT"'))
    with pytest.raises(InputError, match=r"left\.xodr: line 3: a road of left-hand traffic \(rule LHT\)"):
        import_opendrive(tmp_path / "left.xodr", tmp_path / "a.net.xml")
    assert not (tmp_path / "a.net.xml").exists()


def test_an_openstreetmap_is_no_lanelet2_map(tmp_path: Path) -> None:
    pytest.importorskip("lanelet2")
    nodes = "".join(f'<node id="{n}" lat="49.00{n}" lon="8.4"/>' for n in (1, 2))
    way = '<way id="5"><nd ref="1"/><nd ref="2"/><tag k="highway" v="residential"/></way>'
    (tmp_path / "map.osm").write_text(f'<?xml version="1.0"?><osm version="0.6">{nodes}{way}</osm>')
    with pytest.raises(InputError, match=r"no lanelets that .*; it has 1 ways with tag highway, as OpenStreetMap"):
        lanelet2_osm.read_lanelets(tmp_path / "map.osm", (49.0, 8.4))
