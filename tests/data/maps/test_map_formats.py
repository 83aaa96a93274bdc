"""Lane graphs as nets: by hand, from CommonRoad, Lanelet2 and OpenDRIVE files that the tests write."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest

from command_line import refusal
from litsim_data.cli import main
from litsim_data.exports.export import add
from litsim_data.maps.check import check_net
from litsim_data.maps.connectivity import connectivity
from litsim_data.maps.lane_graph import LaneGraph, Lanelet
from litsim_data.maps.map_format import CommonRoad, Lanelet2
from litsim_data.maps.net_builder import write_graph
from litsim_data.maps.netconvert import import_opendrive
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import read_links
from made_maps import add_lanelets, opendrive, road

WIDTH = 3.5

pytestmark = pytest.mark.usefixtures("netconvert")


def straight(name: str, start: tuple[float, float], end: tuple[float, float], *successors: str) -> Lanelet:
    line = np.array([start, end])
    along = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
    left = 0.5 * WIDTH * np.array([-along[1], along[0]])
    return Lanelet(name, line + left, line - left, successors)


def crossing() -> LaneGraph:
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
    return LaneGraph(tuple(lanes))


@pytest.fixture
def net(tmp_path: Path) -> Path:
    return tmp_path / "made.net.xml"


def lanes_of(graph: LaneGraph, net: Path) -> LaneMap:
    """The lanes of the net that a graph becomes."""
    write_graph(graph, net)
    return LaneMap.from_net(net)


def mapped(net: Path, *options: object) -> LaneMap:
    """The lanes of the net that `data map` writes."""
    main(["map", *map(str, options), "--out", str(net)])
    return LaneMap.from_net(net)


def by_place(lane_map: LaneMap, x: float, y: float) -> str:
    at = lane_map.nearest(np.array([x]), np.array([y]))
    return lane_map.lanes[at.lane[0]].id


# Lanelets to nets


def test_crossing_lanelets_become_one_junction(net: Path) -> None:
    assert write_graph(crossing(), net).notes == ()
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


def test_signals_make_a_signalised_junction(net: Path) -> None:
    before, within = ("right_in", "north_over"), {"right_in": ("a", "b"), "north_over": ("c",)}
    graph = crossing()
    lanes = tuple(replace(one, lights=within[one.id] if one.id in before else ()) for one in graph.lanelets)
    graph = LaneGraph(lanes, turns={"a": ("left",), "b": ("straight", "right")})
    groups = write_graph(graph, net).controlled(graph)
    assert 'type="traffic_light"' in net.read_text()
    assert groups == {"b": ["right_in_0 -> right_out_0"], "c": ["north_in_0 -> north_out_0"]}
    assert {name for members in groups.values() for name in members} <= {link.name for link in read_links(net)}


def mirrored(graph: LaneGraph) -> LaneGraph:
    """The same lanes, seen in a mirror."""
    flip = np.array([1.0, -1.0])
    lanes = [replace(one, left=one.right * flip, right=one.left * flip) for one in graph.lanelets]
    return LaneGraph(tuple(replace(one, left_id=one.right_id, right_id=one.left_id) for one in lanes))


def test_left_hand_traffic_is_the_mirror_image(tmp_path: Path) -> None:
    """Lanes, connections, and who gives way to whom; told by the side on which the oncoming lane lies."""
    back = [straight("left_back", (60, 5.25), (10, 5.25), "back_over")]
    back += [straight("back_over", (10, 5.25), (-10, 5.25), "back_out"), straight("back_out", (-10, 5.25), (-60, 5.25))]
    graph = LaneGraph((*crossing().lanelets, *back))
    assert not graph.keeps_left and mirrored(graph).keeps_left
    right, left = (lanes_of(one, tmp_path / str(one.keeps_left)) for one in (graph, mirrored(graph)))
    roots = [ET.parse(tmp_path / str(keeps_left)).getroot() for keeps_left in (False, True)]
    assert [root.get("lefthand") for root in roots] == [None, "true"]
    assert [lane.id for lane in right.lanes] == [lane.id for lane in left.lanes]
    for one, other in zip(right.lanes, left.lanes, strict=True):
        assert (one.left, one.right, one.successors) == (other.right, other.left, other.successors)
        np.testing.assert_allclose(one.centerline * [1, -1], other.centerline, atol=2e-3)
    yields = [sorted((one.get("index"), one.get("response")) for one in root.iter("request")) for root in roots]
    assert yields[0] == yields[1] and any("1" in response for _, response in yields[0])


@pytest.mark.parametrize(("height", "meeting"), [(0.5, True), (6.0, False)])
def test_roads_on_two_levels_do_not_meet(height: float, meeting: bool, net: Path) -> None:
    over = [straight(name, (x, 0), (x + 40, 0), after) for name, x, after in (("a", -60, "b"), ("b", -20, "c"))]
    over = [replace(one, left=np.c_[one.left, [height] * 2], right=np.c_[one.right, [height] * 2]) for one in over]
    under = [
        straight("d", (0, -60), (0, -20), "e"),
        straight("e", (0, -20), (0, 20), "f"),
        straight("f", (0, 20), (0, 60)),
    ]
    lane_map = lanes_of(LaneGraph((*over, straight("c", (20, 0), (60, 0)), *under)), net)
    inside = {
        name: by_place(lane_map, *at).startswith(":") for name, at in {"b": (10.0, 0.0), "e": (0.0, 10.0)}.items()
    }
    assert inside == {"b": meeting, "e": meeting}, "a lane of an intersection, or of a road that passes over another"
    assert connectivity(lane_map).crossings == ()


def test_lanelets_one_after_the_other_need_no_turn(net: Path) -> None:
    lanes = straight("a", (0, 0), (50, 0), "b"), straight("b", (50, 0), (90, 0))
    lane_map = lanes_of(LaneGraph(lanes), net)
    path = lane_map.path_from(lane_map.row("a_0"), 0.0, 90.0)
    np.testing.assert_allclose(path[:, 1], 0.0, atol=2e-3)
    assert path[-1, 0] == pytest.approx(90.0, abs=0.02)


@pytest.mark.parametrize(
    ("lanelets", "message"),
    [
        ((straight("a", (0, 0), (50, 0), "far"), straight("far", (50, 0), (1e9, 0))), "lanelet far is 1e\\+06 km long"),
        ((), "holds no lanelets"),
    ],
)
def test_lanelets_that_make_no_net(lanelets: tuple[Lanelet, ...], message: str, net: Path) -> None:
    with pytest.raises(InputError, match=message):
        write_graph(LaneGraph(lanelets), net)


def test_predecessors_count_as_successors_and_opposite_neighbours_do_not() -> None:
    ahead, back = straight("a", (0, 0), (50, 0)), straight("back", (50, 3.5), (0, 3.5))
    after = replace(straight("b", (50, 0), (90, 0)), predecessors=("a",))
    by_id = LaneGraph((replace(ahead, left_id="back"), after, replace(back, left_id="a"))).by_id
    assert by_id["a"].successors == ("b",) and by_id["a"].left_id is None and by_id["back"].left_id is None


# CommonRoad


def test_commonroad_through_the_command(tmp_path: Path, net: Path) -> None:
    root = ET.Element("commonRoad", {"commonRoadVersion": "2020a"})
    add(add_lanelets(root, crossing().lanelets)["right_in"], "trafficSignRef", ref=7)
    add(add(root, "trafficSign", id=7), "trafficSignElement/additionalValue", 15.6)
    ET.ElementTree(root).write(tmp_path / "map.xml")
    lane_map = mapped(net, "--commonroad", tmp_path / "map.xml")
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
            CommonRoad().read(bad, None)
    with pytest.raises(InputError, match="no such CommonRoad file"):
        CommonRoad().read(tmp_path / "absent.xml", None)


@pytest.mark.data
@pytest.mark.parametrize(
    ("street", "name", "share"),
    [
        ("lankershim", "USA_Lanker-1_2", 0.99),
        ("peachtree", "USA_Peach-2_1", 0.985),  # the map's own lanelets hold 99.0 % of them
        ("peachtree", "USA_Peach-4_2", 0.99),
    ],
)
def test_real_lanelet_maps_hold_the_vehicles_of_their_windows(
    street: str, name: str, share: float, net: Path, real_data: Callable[[str], Path]
) -> None:
    windows = real_data(f"ngsim/{street}_commonroad_windows.parquet")
    graph = CommonRoad().read(real_data(f"maps/commonroad/{name}_map.xml"), None)
    lane_map = lanes_of(graph, net)
    ends = np.array([lanelet.centerline[at] for lanelet in graph.lanelets for at in (0, -1)])
    for lane in lane_map.lanes:  # netconvert has neither cut nor lengthened a lane
        if not lane.is_internal:
            for point in lane.centerline[[0, -1]]:
                assert np.hypot(*(ends - point).T).min() < 0.005, lane.id
    rows = pd.read_parquet(windows, filters=[("scenario", "==", name)])
    rows = rows.rename(columns={"x_m": "x", "y_m": "y", "heading_rad": "yaw"}).assign(lane=-1)
    checked = check_net(net, {name: rows})
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
ORIGIN = ("--origin", "49.0", "8.4")
RELATION = (
    '<relation id="{id}"><member type="way" ref="{left}" role="left"/><member type="way" ref="{right}" role="right"/>'
    '<tag k="type" v="lanelet"/><tag k="subtype" v="road"/><tag k="location" v="urban"/><tag k="one_way" v="yes"/>'
    '<tag k="participant:vehicle" v="yes"/><tag k="speed_limit" v="36 km/h"/></relation>'
)


@pytest.fixture
def osm(tmp_path: Path) -> Path:
    """Two lanes to the north of 100 m from (49 N, 8.4 E), the left one going on for 50 m."""
    pytest.importorskip("lanelet2", reason="the lanelet2 package is not installed: requirements/maps.txt")
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
    path = tmp_path / "map.osm"
    path.write_text(OSM.format(nodes="\n".join(nodes), relations="\n".join(relations)))
    return path


def test_lanelet2_through_the_command(osm: Path, net: Path) -> None:
    lanes = {lane.id: lane for lane in mapped(net, "--lanelet2", osm, *ORIGIN).lanes if not lane.is_internal}
    assert set(lanes) == {"32_0", "32_1", "33_0"}
    assert lanes["32_1"].length == pytest.approx(100.0, abs=0.3)
    assert lanes["32_1"].width == pytest.approx(3.5, abs=0.05)
    assert lanes["32_1"].speed_limit == pytest.approx(10.0, abs=0.01)
    assert len(lanes["32_1"].successors) == 1 and lanes["32_0"].successors == ()
    np.testing.assert_allclose(lanes["32_1"].centerline[0], [-1.75, 0.0], atol=0.1)


def test_lanelets_that_are_no_one_way_lead_both_ways(osm: Path, net: Path) -> None:
    edited(osm, ('k="one_way" v="yes"', 'k="one_way" v="no"'))
    graph = Lanelet2().read(osm, (49.0, 8.4))
    assert {name.strip("-") for name in graph.by_id} == {"31", "32", "33"} and len(graph.by_id) == 6
    assert graph.by_id["31"].successors == ("33",) and graph.by_id["-33"].successors == ("-31",)
    np.testing.assert_allclose(graph.by_id["-31"].centerline, graph.by_id["31"].centerline[::-1], atol=1e-6)
    assert not graph.keeps_left and not write_graph(graph, net).notes


def test_an_origin_far_from_the_map_is_told_in_one_line(
    osm: Path, net: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refusal(capsys, main, "map", "--lanelet2", osm, "--origin", 8.4, 49.0, "--out", net).splitlines()[-1]
    assert said.startswith("error: ") and "out of legal range for UTM zone" in said and "more such lines" in said
    assert said.endswith("is --origin 8.4 49, latitude and longitude, near the map?")


def test_lanelet2_without_the_package_or_an_origin(
    osm: Path, net: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["map", "--lanelet2", osm, "--out", net]
    assert "needs --origin LAT LON" in refusal(capsys, main, *command)
    monkeypatch.setitem(sys.modules, "lanelet2.core", None)
    told = "lanelet2 is not installed here, and this needs it: `make setup-all`"
    assert told in refusal(capsys, main, *command, *ORIGIN)


# OpenDRIVE

PLAIN = {"begin": (5.0, 7.0), "length": 120.0, "left": 0, "right": 2}


@pytest.fixture
def xodr(tmp_path: Path) -> Path:
    """A road with two lanes to the east."""
    path = tmp_path / "map.xodr"
    path.write_text(opendrive(road(**PLAIN)))
    return path


def test_opendrive_through_the_command(xodr: Path, net: Path) -> None:
    lane_map = mapped(net, "--opendrive", xodr)
    assert [lane.width for lane in lane_map.lanes] == pytest.approx([3.5, 3.5])
    left, right = sorted(lane_map.lanes, key=lambda lane: -lane.centerline[0, 1])
    np.testing.assert_allclose(left.centerline[[0, -1]], [[5.0, 5.25], [125.0, 5.25]], atol=0.02)
    assert right.left == left.id


SIGN = '<signal s="60" t="-4" id="{}" dynamic="no" orientation="+" zOffset="2" type="{}" subtype="" value="-1"/>'


def test_signs_of_opendrive_that_cannot_be_read_are_left_out(xodr: Path, net: Path) -> None:
    signs = (
        f"<signals>{SIGN.format(1, 274)}{SIGN.format(2, '')}<signalReference id='2' s='9' orientation='+'/></signals>"
    )
    edited(xodr, ("</lanes>", f"</lanes>{signs}"))
    notes = import_opendrive(xodr, net)
    left_out = "of road 1 is left out, as it has no {} that can be read"
    assert notes == [
        f"{what} {left_out.format(lack)}" for what, lack in (("signal 2", "type"), ("signalReference 2", "signal"))
    ]
    assert len(LaneMap.from_net(net).lanes) == 2


def test_opendrive_that_is_missing_or_malformed(xodr: Path, net: Path) -> None:
    with pytest.raises(InputError, match="no such OpenDRIVE file"):
        import_opendrive(xodr.with_name("absent.xodr"), net)
    xodr.write_text("no XML")
    with pytest.raises(InputError, match=r"map\.xodr: not a readable OpenDRIVE file: [^\n]+$"):
        import_opendrive(xodr, net)


def direct_junction(main_at: str = "start") -> str:
    """A two-way road (1) with two lanes to the east, of which the right one becomes a ramp (3), the other road 2."""
    at = '<{} elementType="junction" elementId="9"/>'
    into, out = at.format("successor"), at.format("predecessor")
    return opendrive(
        road(1, (0, 0), 100, 1, 2, link=into),
        road(2, (100, 0), 100, 1, 1, link=out),
        road(3, (100, -3.5), 100, 0, 1, link=out),
        f'<junction id="9" type="direct"><connection id="0" incomingRoad="1" linkedRoad="2" contactPoint="{main_at}">'
        '<laneLink from="1" to="1"/><laneLink from="-1" to="-1"/></connection><connection id="1" incomingRoad="1" '
        'linkedRoad="3" contactPoint="start"><laneLink from="-2" to="-1"/></connection></junction>',
    )


def test_direct_junctions_of_opendrive_join_roads_in_both_directions(xodr: Path, net: Path) -> None:
    xodr.write_text(direct_junction())
    lane_map = mapped(net, "--opendrive", xodr)
    for begin, end, heading in (
        ((50.0, -1.75), (150.0, -1.75), 0.0),  # to the east
        ((50.0, -5.25), (150.0, -5.25), 0.0),  # onto the ramp
        ((150.0, 1.75), (50.0, 1.75), np.pi),  # to the west
    ):
        here, there = lane_map.nearest(*np.array([(*begin, heading), (*end, heading)]).T).lane.tolist()
        assert lane_map.road_ahead(here)[0] == there != here
        path = lane_map.path_from(here, 50.0, 100.0)
        assert np.abs(path[:, 1] - begin[1]).max() < 0.01
    assert connectivity(lane_map).crossings == ()


def test_direct_junctions_that_cannot_be_read(xodr: Path, net: Path) -> None:
    xodr.write_text(direct_junction("end"))
    told = r"map\.xodr: connection 0 of the direct junction 9 joins two roads at their ends, expected the start"
    with pytest.raises(InputError, match=told):
        import_opendrive(xodr, net)


def test_opendrive_of_left_hand_traffic(xodr: Path, net: Path) -> None:
    """A lane on each side of a bend whose middle is shifted to the left; the left one leads along the road."""
    shifted = '<laneOffset s="0" a="0.5" b="0" c="0" d="0"/>'
    bend = PLAIN | {"left": 1, "right": 1, "shape": '<arc curvature="0.01"/>', "offset": shifted}
    xodr.write_text(opendrive(road(**bend, rule=' rule="LHT"')))
    centre, begin, end = np.array([5.0, 107.0]), -0.5 * np.pi, -0.5 * np.pi + 1.2

    def at(left: float, angle: float) -> np.ndarray:
        return centre + (100.0 - 0.5 - left) * np.array([np.cos(angle), np.sin(angle)])

    for left_hand, side in ((None, 1.0), (False, -1.0)):
        notes = import_opendrive(xodr, net, left_hand)
        lane_map = LaneMap.from_net(net)
        first, second = sorted(lane_map.lanes, key=lambda lane: lane.centerline[0, 0])
        np.testing.assert_allclose(first.centerline[[0, -1]], [at(side * 1.75, begin), at(side * 1.75, end)], atol=0.1)
        np.testing.assert_allclose(
            second.centerline[[0, -1]], [at(-side * 1.75, end), at(-side * 1.75, begin)], atol=0.1
        )
    assert notes == ["1 of 1 roads keep to the left by rule, but are read as keeping to the right"]


def test_roads_of_opendrive_keep_to_the_side_of_their_own_rule(
    xodr: Path, net: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two roads of the left rule, the second of which goes on from the end of the first, and one of the right rule."""
    linked = {
        number: f'<{end} elementType="road" elementId="{other}" contactPoint="{at}"/>'
        for number, end, other, at in ((1, "successor", 2, "start"), (2, "predecessor", 1, "end"))
    }
    inside = '<link><predecessor id="{0}"/><successor id="{0}"/></link>'
    roads = (
        road(number, (x, y), 100, 2, 2, rule=f' rule="{rule}"', link=linked.get(number, ""), lane_link=inside)
        for number, rule, x, y in ((1, "LHT", 0, 0), (2, "LHT", 100, 0), (3, "RHT", 0, 50))
    )
    xodr.write_text(opendrive(*roads))
    lane_map = mapped(net, "--opendrive", xodr)
    assert "2 of 3 roads keep to the left by rule, the others to the right" in capsys.readouterr().err
    outer = [lane.centerline for lane in lane_map.lanes if not lane.is_internal]
    ends = sorted(tuple(float(value) for value in np.round(line[[0, -1]].ravel(), 2)) for line in outer)
    sides_of = {0.0: 1.0, 50.0: -1.0}  # where lanes lead along x, as seen from the reference line
    expected = [
        (x, y + side * left, x + 100.0, y + side * left) if along else (x + 100.0, y - side * left, x, y - side * left)
        for x, y in ((0.0, 0.0), (100.0, 0.0), (0.0, 50.0))
        for side in (sides_of[y],)
        for left in (1.75, 5.25)
        for along in (True, False)
    ]
    np.testing.assert_allclose(ends, sorted(expected), atol=0.02)
    through = lane_map.path_from(lane_map.nearest(np.array([10.0]), np.array([1.75])).lane[0], 10.0, 150.0)
    assert np.abs(through[:, 1] - 1.75).max() < 0.02 and through[-1, 0] > 150.0


def test_an_openstreetmap_is_no_lanelet2_map(osm: Path) -> None:
    nodes = "".join(f'<node id="{n}" lat="49.00{n}" lon="8.4"/>' for n in (1, 2))
    way = '<way id="5"><nd ref="1"/><nd ref="2"/><tag k="highway" v="residential"/></way>'
    osm.write_text(f'<?xml version="1.0"?><osm version="0.6">{nodes}{way}</osm>')
    with pytest.raises(InputError, match=r"no lanelets that .*; it has 1 ways with tag highway, as OpenStreetMap"):
        Lanelet2().read(osm, (49.0, 8.4))


def edited(path: Path, *pairs: tuple[str, str]) -> None:
    text = path.read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


@pytest.mark.parametrize("kind", ["crosswalk", "detection_area", "road_marking"])
def test_regulatory_elements_of_autoware_are_ignored_with_a_line(
    kind: str, osm: Path, net: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rule = (
        f'<relation id="301"><member type="way" role="refers" ref="21"/><tag k="type" v="regulatory_element"/>'
        f'<tag k="subtype" v="{kind}"/></relation></osm>'
    )
    member = '<relation id="33"><member type="relation" role="regulatory_element" ref="301"/>'
    edited(osm, ("</osm>", rule), ('<relation id="33">', member))
    lanes = {lane.id for lane in mapped(net, "--lanelet2", osm, *ORIGIN).lanes if not lane.is_internal}
    assert f"ignored: 1 regulatory elements {kind}, which are no lanes" in capsys.readouterr().err
    assert lanes == {"32_0", "32_1", "33_0"}


@pytest.mark.parametrize("origin", [[], ["--origin", "0", "0"]])
def test_coordinates_in_metres_as_of_autoware(origin: list[str], osm: Path, net: Path) -> None:
    places = {1: (0, 4), 2: (40, 4), 3: (0, 0), 4: (40, 0)}
    tags = '<tag k="local_x" v="{}"/><tag k="local_y" v="{}"/>'
    nodes = "".join(f'<node id="{i}" lat="0" lon="0">{tags.format(*at)}</node>' for i, at in places.items())
    ways = "".join(f'<way id="{w}"><nd ref="{a}"/><nd ref="{b}"/></way>' for w, a, b in ((21, 1, 2), (22, 3, 4)))
    text = f'<osm version="0.6">{nodes}{ways}{RELATION.format(id=31, left=21, right=22)}</osm>'
    osm.write_text(text)
    (lane,) = mapped(net, "--lanelet2", osm, *origin).lanes
    np.testing.assert_allclose(lane.centerline[[0, -1]], [[0, 2], [40, 2]], atol=2e-3)
    edited(osm, ('v="40"', 'v="far"'))
    with pytest.raises(InputError, match=r"node 2: local_x and local_y are \['far', '4'\]"):
        Lanelet2().read(osm, None)


@pytest.mark.parametrize("second", ['<nd ref="9"/><nd ref="2"/>', '<nd ref="2"/><nd ref="9"/>'])
def test_borders_that_are_chains_of_ways_are_joined(second: str, osm: Path) -> None:
    whole = '<way id="21"><nd ref="1"/><nd ref="2"/>'
    halves = f'<way id="26">{second}</way><way id="21"><nd ref="1"/><nd ref="9"/>'
    middle = f'<node id="9" lat="{49 + 50 / 111_213:.9f}" lon="{8.4 - 3.5 / 73_170:.9f}"/>\n  <way id="21">'
    left = '<member type="way" ref="21" role="left"/>'
    more = f'<member type="way" ref="26" role="left"/>{left}'
    edited(osm, ('<way id="21">', middle), (whole, halves), (left, more))
    graph = Lanelet2().read(osm, (49.0, 8.4))
    assert graph.notes == ("joined: 1 borders that are chains of ways",)
    assert graph.by_id["31"].length == pytest.approx(100.0, abs=0.3)
    assert graph.by_id["31"].width == pytest.approx(3.5, abs=0.05) and graph.by_id["31"].successors == ("33",)


def test_points_that_are_opposite_but_for_rounding_are_one_of_the_middle() -> None:
    """At 0.3 of both bounds: two points there would give the line no direction, as in a map of Argoverse 2."""
    opposite = float(np.nextafter(3.0, 4.0))
    sides = ([0.0, opposite, 10.0], 2.0), ([0.0, 2.1, 5.0, 7.0], 0.0)
    left, right = (np.column_stack([x, np.full(len(x), y)]) for x, y in sides)
    line = Lanelet("a", left, right).centerline
    assert np.diff(line[:, 0]).min() > 0.1 and line[[0, -1]].tolist() == [[0.0, 1.0], [8.5, 1.0]]
    assert np.isclose(line[:, 0], 0.3 * 8.5).sum() == 1
