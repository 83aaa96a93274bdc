"""Lanes as they are read from a net, and what is said of nets that cannot be."""

from pathlib import Path

import numpy as np
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.net_lanes import read_lanes
from litsim_sim.scenario.scenario import packaged

EDGE = """<edge id="a" from="x" to="y" priority="1">
    <lane id="a_0" index="0" allow="pedestrian" speed="2.0" length="30.0" width="2.0" shape="0,-4 30,-4"/>
    <lane id="a_1" index="1" disallow="pedestrian" speed="13.9" length="30.0" width="3.5" shape="0,0 10,0 10,0 30,0"/>
    <lane id="a_2" index="2" disallow="pedestrian" speed="13.9" length="30.0" width="3.0" shape="0,3 30,3"/>
</edge>"""
LOCATION = '<location netOffset="0,0" convBoundary="0,-4,30,3" origBoundary="0,-4,30,3" projParameter="!"/>'
NODES = "".join(
    f'<junction id="{name}" type="dead_end" x="{x}" y="0" incLanes="" intLanes="" shape="0,0"/>'
    for name, x in (("x", 0), ("y", 30))
)


def test_a_lane_of_a_net(tmp_path: Path) -> None:
    path = tmp_path / "a.net.xml"
    path.write_text(f'<net version="1.20">{LOCATION}{EDGE}{NODES}</net>')
    right, left = sorted(read_lanes(path), key=lambda lane: lane.index)  # nobody drives on the footpath
    assert (right.id, right.edge_id, right.index, right.width, right.speed_limit) == ("a_1", "a", 1, 3.5, 13.9)
    assert (right.left, right.right, left.left, left.right) == ("a_2", None, None, "a_1")
    np.testing.assert_allclose(right.centerline, [[0, 0], [10, 0], [30, 0]])  # the doubled point has no direction
    assert right.s.tolist() == [0.0, 10.0, 30.0] and right.length == 30.0
    assert right.successors == () and not right.is_internal


def test_left_hand_nets_count_their_lanes_from_the_left(tmp_path: Path) -> None:
    path = tmp_path / "a.net.xml"
    mirrored = EDGE.replace(",-4", ",4").replace(",3", ",-3")
    path.write_text(f'<net version="1.20" lefthand="true">{LOCATION}{mirrored}{NODES}</net>')
    right, left = sorted(read_lanes(path), key=lambda lane: lane.index)  # the footpath lies to the left of both
    assert (right.id, right.index, right.left, right.right) == ("a_2", 0, "a_1", None)
    assert (left.id, left.index, left.left, left.right) == ("a_1", 1, None, "a_2")


def test_lanes_inside_junctions_lie_between_others() -> None:
    lanes = {lane.id: lane for lane in read_lanes(packaged("nets/urban_like.net.xml"))}
    inside = [lane for lane in lanes.values() if lane.is_internal]
    assert inside and all(lane.id.startswith(":") for lane in inside)
    for lane in inside:
        assert lane.successors and all(name in lanes for name in lane.successors)


def test_nets_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.net\.xml: no such net"):
        read_lanes(tmp_path / "absent.net.xml")
    bad = tmp_path / "bad.net.xml"
    for text, why in (
        ("no XML", "line 1, column 1: syntax error"),
        ('<net version="1.20">\n <edge', "line 2, column 2: unclosed token"),
        ("<net/>", "attribute 'version' is missing"),
        ('<net version="1.20"><edge id="a" from="x" to="y"><lane/></edge></net>', "attribute 'speed' is missing"),
    ):
        bad.write_text(text)
        with pytest.raises(InputError, match=rf"bad\.net\.xml: not a readable SUMO net: {why}"):
            read_lanes(bad)
    for before, after, why in (
        ("0,3 30,3", "0,3", "lane a_2: field shape has no two points"),
        ("0,3 30,3", "", "lane a_2: field shape has no two points"),
        ("0,3 30,3", "0,nan 30,3", "lane a_2: field shape has no two points with finite coordinates"),
        ('width="3.0"', 'width="-3"', "lane a_2: field width is -3, expected more than 0"),
    ):
        assert before in EDGE
        bad.write_text(f'<net version="1.20">{LOCATION}{EDGE.replace(before, after)}{NODES}</net>')
        with pytest.raises(InputError, match=rf"bad\.net\.xml: {why}"):
            read_lanes(bad)
    bad.write_text(f'<net version="1.20">{LOCATION}{EDGE.replace("0,3 30,3", "0,3 3e6,5e6")}{NODES}</net>')
    with pytest.raises(
        InputError, match=r"covers 3000 km by 5000 km, expected at most 2000 km2.*; lane a_2 is farthest"
    ):
        read_lanes(bad)
    bad.write_text('<commonRoad><location latitude="1"/></commonRoad>')
    with pytest.raises(InputError, match="not a SUMO net: its root element is <commonRoad>, expected <net>"):
        read_lanes(bad)
    bad.write_text('<net version="1.20"></net>')
    with pytest.raises(InputError, match="holds no lanes"):
        read_lanes(bad)
