"""A net as a Lanelet2 map of Autoware, through the ``lanelet2`` package.

Every lane is a lanelet, those inside junctions included. Lanes side by side have the bound between them in common, and
lanes that follow each other the points where they meet, so that Lanelet2's routing graph connects what the net does.
Each connection that a traffic light controls has a light of its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from litsim_data.exports.export import Content, Export
from litsim_data.maps.lane_graph import around, turn_of
from litsim_data.maps.lanelet2_osm import modules
from litsim_data.maps.map_projector import PROJECTOR_FILE
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.lane_map.signal_links import SignalLink, read_links, relation_id

ORIGIN = (49.0, 8.4)
"""Latitude and longitude [deg] of (0, 0) in the file, with which `data map --lanelet2` reads it back. Autoware does not
read it: its coordinates are those of the net, from the tags local_x and local_y."""
TURN = np.radians(20.0)  # change of heading from which on a lane inside a junction is a turn
LEFT, RIGHT = 0, 1
LIGHT_HEIGHT, LIGHT_WIDTH = 5.0, 1.0  # [m] above the road, and across it

_Corner = tuple[int, int, int]
"""An end of a bound: row of the lane, side, and 0 for its beginning or -1 for its end."""


class Lanelet2(Export):
    """The net of what is exported; ids of lights are those of :func:`litsim_sim.lane_map.signal_links.relation_id`."""

    endings, content = (".osm",), "a Lanelet2 map, with Autoware's projector file beside it"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`.export.Export`."""
        core, io, projection = modules("core", "io", "projection")
        lanelet_map = core.LaneletMap()
        for lanelet in _Lanelets(content.lanes(), read_links(content.net_file()), core).all():
            lanelet_map.add(lanelet)
        projector = out.with_name(PROJECTOR_FILE)
        try:
            with replacing(out) as new, replacing(projector) as info:
                io.write(str(new), lanelet_map, projection.UtmProjector(io.Origin(*ORIGIN)))
                info.write_text("projector_type: Local\n", encoding="utf-8")
        except RuntimeError as error:
            raise InputError(f"{out}: cannot be written: {error}") from error
        return [f"beside it: {projector.name}"]


class _Lanelets:
    """The lanelets of a net, with bounds and points that they have in common."""

    def __init__(self, lane_map: LaneMap, links: Sequence[SignalLink], core: Any) -> None:
        self._lanes, self._core = lane_map.lanes, core
        self._links: dict[str, list[SignalLink]] = defaultdict(list)
        for link in links:
            self._links[next(iter(link.via), link.from_lane)].append(link)
        self._stop_lines: dict[str, Any] = {}
        self._row = {lane.id: row for row, lane in enumerate(self._lanes)}
        self._bounds = {
            (row, side): bound
            for row, lane in enumerate(self._lanes)
            for side, bound in zip((LEFT, RIGHT), around(lane.centerline, lane.width), strict=True)
        }
        for row, lane in enumerate(self._lanes):
            if lane.left is not None:  # one bound for both, where both lanes have it
                self._bounds[self._row[lane.left], RIGHT] = self._bounds[row, LEFT]
        self._same = DisjointSet([(row, side, end) for row, side in self._bounds for end in (0, -1)])
        for row, lane in enumerate(self._lanes):
            for side in (LEFT, RIGHT):
                if side == LEFT and lane.left is not None:
                    for end in (0, -1):
                        self._same.merge((row, LEFT, end), (self._row[lane.left], RIGHT, end))
                for name in lane.successors:
                    self._same.merge((row, side, -1), (self._row[name], side, 0))
        self._points: dict[_Corner, Any] = {}
        self._lines: dict[tuple[int, int], Any] = {}
        self._crossings = _crossings(self._lanes)

    def all(self) -> list[Any]:
        """The lanelets of all lanes."""
        return [self._lanelet(row, lane) for row, lane in enumerate(self._lanes)]

    def _lanelet(self, row: int, lane: Lane) -> Any:
        lanelet = self._core.Lanelet(self._core.getId(), self._line(row, LEFT), self._line(row, RIGHT))
        attributes = {
            "type": "lanelet",
            "subtype": "road",
            "location": "urban",
            "one_way": "yes",
            "participant:vehicle": "yes",
            "speed_limit": f"{3.6 * lane.speed_limit:.6g}",
            "litsim_lane": lane.id,
        }
        if lane.junction in self._crossings:
            attributes["turn_direction"] = turn_of(lane.centerline, TURN)
        for name, value in attributes.items():
            lanelet.attributes[name] = value
        for link in self._links[lane.id]:
            lanelet.addRegulatoryElement(self._light(link))
        return lanelet

    def _light(self, link: SignalLink) -> Any:
        """The traffic light of a connection: beyond the junction, where it faces those that come."""
        core = self._core
        if link.from_lane not in self._stop_lines:
            stop = _across(link.stop, link.heading, link.width)
            self._stop_lines[link.from_lane] = self._line_of(stop, {"type": "stop_line", "subtype": "solid"})
        attributes = {"type": "traffic_light", "subtype": "red_yellow_green", "height": "1.0"}
        light = self._line_of(_across(link.exit, link.heading, LIGHT_WIDTH), attributes, LIGHT_HEIGHT)
        stop_line = self._stop_lines[link.from_lane]
        return core.TrafficLight(relation_id(link.name), core.AttributeMap(), [light], stop_line)

    def _line_of(self, places: FloatArray, attributes: dict[str, str], height: float = 0.0) -> Any:
        line = self._core.LineString3d(self._core.getId(), [self._point(place, height) for place in places])
        for name, value in attributes.items():
            line.attributes[name] = value
        return line

    def _line(self, row: int, side: int) -> Any:
        """The line string of a bound; that of two lanes side by side is one."""
        lane = self._lanes[row]
        if side == RIGHT and lane.right is not None and self._lanes[self._row[lane.right]].left == lane.id:
            return self._line(self._row[lane.right], LEFT)
        if (row, side) not in self._lines:
            bound = self._bounds[row, side]
            inside = [self._point(place) for place in bound[1:-1]]
            points = [self._corner((row, side, 0)), *inside, self._corner((row, side, -1))]
            line = self._core.LineString3d(self._core.getId(), points)
            line.attributes["type"] = "line_thin"
            line.attributes["subtype"] = "dashed" if side == LEFT and lane.left is not None else "solid"
            self._lines[row, side] = line
        return self._lines[row, side]

    def _corner(self, corner: _Corner) -> Any:
        """The point at the end of a bound, which those that meet there have in common."""
        name = self._same[corner]
        if name not in self._points:
            members = sorted(self._same.subset(corner))
            outside = [end for end in members if not self._lanes[end[0]].is_internal] or members
            self._points[name] = self._point(np.mean([self._bounds[r, s][e] for r, s, e in outside], axis=0))
        return self._points[name]

    def _point(self, place: FloatArray, height: float = 0.0) -> Any:
        x, y = float(place[0]), float(place[1])
        point = self._core.Point3d(self._core.getId(), x, y, height)
        point.attributes["local_x"], point.attributes["local_y"] = f"{x:.4f}", f"{y:.4f}"
        point.attributes["ele"] = f"{height:g}"
        return point


def _across(middle: FloatArray, heading: float, width: float) -> FloatArray:
    """(2, 2) ends of a line across a lane, from left to right of `heading` [rad]."""
    left = 0.5 * width * np.array([-np.sin(heading), np.cos(heading)])
    return np.stack([middle + left, middle - left])


def _crossings(lanes: Iterable[Lane]) -> set[str]:
    """Junctions with several ways in and several out: intersections, and not where a road merges or goes on."""
    by_id = {lane.id: lane for lane in lanes}
    ways: dict[str, tuple[set[str], set[str]]] = defaultdict(lambda: (set(), set()))
    for lane in lanes:
        for after in map(by_id.__getitem__, lane.successors):
            if after.junction and not lane.junction:
                ways[after.junction][0].add(lane.edge_id)
            elif lane.junction and not after.junction:
                ways[lane.junction][1].add(after.edge_id)
    return {name for name, (come, go) in ways.items() if len(come) > 1 and len(go) > 1}
