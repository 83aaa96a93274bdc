"""A net for Autoware: its routing graph is that of the net, its lanes lie where they did, and it is read back."""

from pathlib import Path

import numpy as np
import pytest

from litsim_data.exports.export import Content
from litsim_data.exports.lanelet2 import ORIGIN
from litsim_data.exports.lanelet2 import Lanelet2 as Lanelet2Export
from litsim_data.maps.map_format import Lanelet2
from litsim_data.maps.map_projector import PROJECTOR_FILE
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import read_links, relation_id
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import read_signals

pytest.importorskip("lanelet2.core")
from lanelet2 import io, projection, routing, traffic_rules
from lanelet2.core import GPSPoint

MAP_FILE = "lanelet2_map.osm"


@pytest.mark.parametrize("net", ["us101_like", "us101", "urban_like"])
def test_the_routing_graph_is_that_of_the_net(net: str, tmp_path: Path) -> None:
    path = packaged(f"nets/{net}.net.xml")
    lane_map, links = LaneMap.from_net(path), read_links(path)
    Lanelet2Export().write(Content(net, path, net=path), tmp_path / MAP_FILE)
    assert (tmp_path / PROJECTOR_FILE).read_text() == "projector_type: Local\n"
    loaded = io.load(str(tmp_path / MAP_FILE), projection.UtmProjector(io.Origin(*ORIGIN)))
    rules = traffic_rules.create(traffic_rules.Locations.Germany, traffic_rules.Participants.Vehicle)
    graph = routing.RoutingGraph(loaded, rules)
    assert graph.checkValidity() == []
    lanelets = {each.attributes["litsim_lane"]: each for each in loaded.laneletLayer}
    assert set(lanelets) == {lane.id for lane in lane_map.lanes}
    for lane in lane_map.lanes:
        lanelet = lanelets[lane.id]
        assert {each.attributes["litsim_lane"] for each in graph.following(lanelet)} >= set(lane.successors)
        if lane.left is not None:
            assert graph.left(lanelet).attributes["litsim_lane"] == lane.left
        if lane.right is not None:
            assert graph.right(lanelet).attributes["litsim_lane"] == lane.right
        for point in lanelet.leftBound:
            local = [float(point.attributes[name]) for name in ("local_x", "local_y")]
            assert [point.x, point.y] == pytest.approx(local, abs=1e-3)
        if not lane.is_internal:
            middle = 0.5 * (ends(lanelet.leftBound) + ends(lanelet.rightBound))
            assert middle == pytest.approx(lane.centerline[[0, -1]], abs=3e-3)
            across = ends(lanelet.leftBound) - ends(lanelet.rightBound)
            assert np.hypot(*across.T) == pytest.approx(lane.width, abs=3e-3)
    lights = {element.id: lane for lane, lanelet in lanelets.items() for element in lanelet.trafficLights()}
    assert lights == {relation_id(link.name): link.via[0] for link in links}
    for link in links:
        (light,) = lanelets[link.via[0]].trafficLights()
        stop = ends(light.stopLine)
        assert stop.mean(axis=0) == pytest.approx(link.stop, abs=1e-3)
        assert np.hypot(*np.diff(stop, axis=0)[0]) == pytest.approx(link.width, abs=1e-3)
    turns = {each.attributes["turn_direction"] for each in lanelets.values() if "turn_direction" in each.attributes}
    assert turns == ({"left", "right", "straight"} if net == "urban_like" else set())


def ends(bound: object) -> np.ndarray:
    return np.array([[bound[at].x, bound[at].y] for at in (0, -1)])  # type: ignore[index]


@pytest.mark.parametrize("net", ["us101_like", "us101", "urban_like"])
def test_a_net_comes_back_as_it_was(net: str, tmp_path: Path) -> None:
    path = packaged(f"nets/{net}.net.xml")
    lane_map = LaneMap.from_net(path)
    Lanelet2Export().write(Content("net", path, net=path), tmp_path / MAP_FILE)
    Lanelet2().write_net(tmp_path / MAP_FILE, None, tmp_path / "back.net.xml")
    back = LaneMap.from_net(tmp_path / "back.net.xml")
    for lane in lane_map.lanes:
        if not lane.is_internal:
            along = np.gradient(lane.centerline, axis=0)
            place = back.nearest(*lane.centerline.T, np.arctan2(along[:, 1], along[:, 0]))
            assert np.abs(place.d).max() < 1.1e-3  # what the file and the net are rounded to


def test_frame_map_is_that_of_autoware(tmp_path: Path) -> None:
    path = packaged("nets/us101_like.net.xml")
    Lanelet2Export().write(Content("net", path, net=path), tmp_path / MAP_FILE)
    own = Lanelet2().read(tmp_path / MAP_FILE, None)
    (tmp_path / PROJECTOR_FILE).write_text("projector_type: MGRS\nmgrs_grid: 32UMV\n")
    found = Lanelet2().read(tmp_path / MAP_FILE, None)
    utm = projection.UtmProjector(io.Origin(*ORIGIN), False, False).forward(GPSPoint(*ORIGIN, 0.0))  # noqa: FBT003 - has no names
    moved = np.array([utm.x - 400_000.0, utm.y - 5_400_000.0])  # corner of the square
    for one, other in zip(own.lanelets, found.lanelets, strict=True):
        assert other.left[:, :2] == pytest.approx(one.left[:, :2] + moved, abs=1e-3)


def test_lights_keep_their_ids_in_the_file_of_signals(tmp_path: Path) -> None:
    """Groups are named as the relations, by which Autoware's adapter publishes them; what users add is kept."""
    path = packaged("nets/urban_like.net.xml")
    links = read_links(path)
    Lanelet2Export().write(Content("urban_like", path, net=path), tmp_path / MAP_FILE)
    net, signals = tmp_path / "again.net.xml", tmp_path / "again_signals.yaml"
    notes = Lanelet2().write_net(tmp_path / MAP_FILE, None, net)
    assert f"signals: {len(links)} traffic lights of the map -> {signals}; name there what they show" in notes
    (tmp_path / "states.csv").write_text(
        "group,begin,state\n" + "".join(f"{relation_id(link.name)},0,red\n" for link in links)
    )
    groups = read_signals(signals).groups
    assert {*groups} == {str(relation_id(link.name)) for link in links}
    assert sorted(name for members in groups.values() for name in members) == sorted(
        one.name for one in read_links(net)
    )
    signals.write_text("groups: {}\n")
    assert f"signals: {signals} exists already and is kept" in Lanelet2().write_net(tmp_path / MAP_FILE, None, net)
    assert signals.read_text() == "groups: {}\n"
