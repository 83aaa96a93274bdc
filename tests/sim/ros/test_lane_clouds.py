"""The lane graph as clouds, which any stack can read."""

from typing import Any

import numpy as np
import pytest

from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.ros.lane_clouds import goal_pose, lane_links, lane_table
from litsim_sim.scenario.mission import Mission
from litsim_sim.scenario.scenario import packaged

NET = packaged("nets/urban_like.net.xml")
STREET = LaneMap.from_net(NET)
NONE = 0xFFFFFFFF


def read(cloud: Any) -> np.ndarray:
    """As the examples read it."""
    return np.frombuffer(cloud.data, {f.name: (" bBhHiIfd"[f.datatype], f.offset) for f in cloud.fields})


@pytest.fixture
def mission() -> Mission:
    on_route = np.array([lane.edge_id in ("WA", "AB") for lane in STREET.lanes])
    entered = np.where([lane.id == "WA_0" for lane in STREET.lanes], 0.0, np.nan)
    return Mission(np.zeros((2, 2)), np.array([10.0, 20.0, 0.5 * np.pi]), on_route, entered)


def test_a_lane_with_its_limit_its_neighbours_and_its_place_on_the_route(mission: Mission) -> None:
    table = read(lane_table(STREET, mission))
    assert len(table) == len(STREET.lanes)
    lane, inside = table[STREET.row("WA_1")], table[STREET.row(":A_10_0")]
    assert (lane["left"], lane["right"]) == (STREET.row("WA_2"), STREET.row("WA_0"))
    assert table[STREET.row("WA_0")]["right"] == NONE
    assert lane["speed_limit"] == pytest.approx(13.89) and (lane["on_route"], lane["inside_junction"]) == (1, 0)
    assert inside["speed_limit"] == pytest.approx(13.89), "not the speed at which SUMO's vehicles turn"
    assert inside["inside_junction"] == 1
    assert [lane["x64"], lane["y64"]] == STREET.lanes[STREET.row("WA_1")].centerline[0].tolist()
    assert np.flatnonzero(np.isfinite(table["entered"])).tolist() == [STREET.row("WA_0")]
    pose = goal_pose(mission).pose
    assert (pose.position.x, pose.position.y, pose.orientation.z) == pytest.approx((10.0, 20.0, np.sqrt(0.5)))


def test_which_lanes_follow_and_which_light_controls_the_way(mission: Mission) -> None:
    links = read_links(NET)
    ways = read(lane_links(STREET, links))
    assert len(ways) == sum(len(lane.successors) for lane in STREET.lanes)
    (way,) = ways[(ways["lane"] == STREET.row("WA_0")) & (ways["to_lane"] == STREET.row(":A_10_0"))]
    assert links[way["light"]].name == "WA_0 -> AAS_0" and way["stop"] == 0
    assert set(ways["light"][ways["light"] != NONE]) == set(range(len(links))), "each light is at one way"
    assert set(read(lane_links(STREET, ()))["light"]) == {NONE}


def test_who_gives_way_by_the_signs() -> None:
    """Side roads, and who turns to the left across the others: before the junction, and where it waits inside it."""
    ways = read(lane_links(STREET, ()))
    minor = {(STREET.lanes[way["lane"]].id, STREET.lanes[way["to_lane"]].id) for way in ways[ways["give_way"] == 1]}
    assert {("ANA_0", ":A_1_0"), ("BA_2", ":A_6_0"), (":A_6_0", ":A_15_0")} <= minor
    assert not {("WA_0", ":A_11_0"), ("BA_0", ":A_4_0")} & minor


def test_a_stop_sign_stands_before_a_way(tmp_path: Any, mission: Mission) -> None:
    (tmp_path / "net.xml").write_text(NET.read_text().replace('dir="s" state="O"', 'dir="s" state="s"'))
    lane_map = LaneMap.from_net(tmp_path / "net.xml")
    ways = read(lane_links(lane_map, ()))
    signs = ways[ways["stop"] == 1]
    assert len(signs) > 0 and not any(lane_map.lanes[row].is_internal for row in signs["lane"])
    (way,) = ways[(ways["lane"] == lane_map.row("WA_0")) & (ways["to_lane"] == lane_map.row(":A_11_0"))]
    assert way["stop"] == 1
