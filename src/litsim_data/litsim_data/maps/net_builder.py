"""Lane graphs as SUMO nets.

Lanelets side by side become one edge whose lanes keep their own centre lines; lanelets inside intersections, where they
cross or split, become connections with the lanelet's centre line as their shape.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from scipy.cluster.hierarchy import DisjointSet

from litsim_data.maps.lane_graph import TURNS, LaneGraph, Lanelet, at_shares, extended, turn, without_repeats
from litsim_data.maps.netconvert import DECIMALS, build_net, shape_text
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_crossings import crossing_pairs, crossing_points
from litsim_sim.lane_map.net_lanes import LEVEL
from litsim_sim.lane_map.signal_links import ARROW

INNER_LENGTH_MAX = 60.0  # [m] longer lanelets that split or join are ramps, not turns
ENDS_APART = 1.0  # [m] centre lines that come nearer than this only at their ends follow each other
ROUNDS_MAX = 50
AREA_GAP = 0.01  # [m] size of the outline that netconvert is given of a junction
EXTENSION = 110.0  # [m] netconvert looks 100 m ahead of a lane for its junction
TURN = np.deg2rad(40.0)  # connections that turn less go straight on
FLAT = 0.5  # [m] of height within which a map counts as flat


@dataclass(frozen=True)
class Connection:
    """From one lanelet outside of intersections to another, over those inside between them.

    Attributes:
        start, end: the lanelets outside.
        inner: those inside, in order.
        turn: left, straight or right.
        name: ``FROM_LANE -> TO_LANE``, by SUMO's ids, once the net is built.
    """

    start: str
    end: str
    inner: tuple[str, ...]
    turn: str
    name: str = ""


@dataclass(frozen=True)
class BuiltNet:
    """What became of a lane graph: notes on what of the map was not used, netconvert's warnings, and connections."""

    notes: tuple[str, ...]
    connections: tuple[Connection, ...]

    def controlled(self, graph: LaneGraph) -> dict[str, list[str]]:
        """Returns the connections that each traffic light of `graph` holds, by its name: groups of signals.

        A connection over lanelets with lights is held by those, another by the lights of the lanelet that it comes
        from; of several, by the first that is for its turn.
        """
        groups: dict[str, list[str]] = {}
        for connection in self.connections:
            over = [light for name in connection.inner for light in graph.by_id[name].lights]
            lights = over or graph.by_id[connection.start].lights if connection.inner else ()
            turns = (graph.turns.get(light, TURNS) for light in lights)
            light = next((name for name, turn in zip(lights, turns, strict=True) if connection.turn in turn), None)
            if light is not None:
                groups.setdefault(light, []).append(connection.name)
        return groups


class _Plan:
    """Which lanelets are edges' lanes, which are connections, and which ends meet in a junction."""

    def __init__(self, graph: LaneGraph) -> None:
        self.by_id = graph.by_id
        self.hilly = bool(np.ptp(np.concatenate([lanelet.heights for lanelet in self.by_id.values()])) > FLAT)
        self.after = {name: lanelet.successors for name, lanelet in self.by_id.items()}
        self.before: dict[str, list[str]] = {name: [] for name in self.by_id}
        for name, following in self.after.items():
            for other in following:
                self.before[other].append(name)
        self.crossing = _crossing_pairs(list(self.by_id.values()))
        self.inner = self._first_inner()
        for _ in range(ROUNDS_MAX):
            self.groups = self._groups()
            self.group_of = {name: row for row, group in enumerate(self.groups) for name in group}
            self.links = list(self._links())
            self.node_of = self._nodes()
            looped = {
                name
                for row, group in enumerate(self.groups)
                if self.node_of[row, 0] == self.node_of[row, 1]
                for name in group
                if self.after[name] and self.before[name]
            }
            used = {name for link in self.links for name in link.inner}
            lost = self.inner - used - self.kept_outer
            self.kept_outer |= lost | (looped & self.kept_outer)
            inner = (self.inner | looped) - self.kept_outer
            if inner == self.inner:
                self.groups = [group[::-1] for group in self.groups] if graph.keeps_left else self.groups
                return
            self.inner = inner
        raise InputError("the lanelets do not add up to roads and junctions")

    def line(self, name: str) -> FloatArray:
        """Returns the centre line (k, 2) of a lanelet, or (k, 3) on a map that is not flat [m]."""
        lanelet = self.by_id[name]
        return np.column_stack([lanelet.centerline, lanelet.heights]) if self.hilly else lanelet.centerline

    def _first_inner(self) -> set[str]:
        """Returns the lanelets inside intersections: by the map, or as they cross others, or are short and split or
        join.
        """
        self.kept_outer: set[str] = set()
        inner = {name for name, lanelet in self.by_id.items() if lanelet.junction}
        inner |= {name for pair in self.crossing for name in pair}
        for following in (self.after, self.before):
            for names in following.values():
                if len(names) > 1:
                    inner |= {name for name in names if self.by_id[name].length < INNER_LENGTH_MAX}
        return {name for name in inner if self.after[name] and self.before[name]}

    def _groups(self) -> list[list[str]]:
        """Returns the outer lanelets that lie side by side, group by group, each with the rightmost first."""
        outer = {name: lanelet for name, lanelet in self.by_id.items() if name not in self.inner}
        left_of: dict[str, str] = {}
        for name, lanelet in outer.items():
            for right, left in ((name, lanelet.left_id), (lanelet.right_id, name)):
                if right in outer and left in outer:
                    left_of.setdefault(str(right), str(left))
        has_right: set[str] = set()
        for name, left in list(left_of.items()):  # a lanelet is the left neighbour of one other only
            if left in has_right:
                del left_of[name]
            has_right.add(left)
        groups, grouped = [], set()
        for name in outer:
            if name in has_right:
                continue
            group = [name]
            while group[-1] in left_of and left_of[group[-1]] not in group:
                group.append(left_of[group[-1]])
            groups.append(group)
            grouped |= set(group)
        return groups + [[name] for name in outer if name not in grouped]

    def _links(self) -> Iterator[Connection]:
        for name in self.group_of:
            stack: list[tuple[str, ...]] = [(other,) for other in self.after[name]]
            while stack:
                path = stack.pop()
                if path[-1] not in self.inner:
                    turned = turn(self.by_id[path[-1]].course(0) - self.by_id[name].course(-1), TURN)
                    yield Connection(name, path[-1], path[:-1], turned)
                else:
                    stack += [(*path, other) for other in self.after[path[-1]] if other not in path]

    def _nodes(self) -> dict[tuple[int, int], int]:
        """Returns the junction of each group's start (row, 0) and end (row, 1): ends that are linked, or whose links
        cross, meet.
        """
        ends = [(row, side) for row in range(len(self.groups)) for side in (0, 1)]
        meeting = DisjointSet([*ends, *self.inner])
        for link in self.links:
            for item in ((self.group_of[link.end], 0), *link.inner):
                meeting.merge((self.group_of[link.start], 1), item)
        for lanelet, other in self.crossing:
            if lanelet in self.inner and other in self.inner:
                meeting.merge(lanelet, other)
        numbers: dict[tuple[int, int] | str, int] = {}
        return {end: numbers.setdefault(meeting[end], len(numbers)) for end in ends}


def write_graph(graph: LaneGraph, path: Path) -> BuiltNet:
    """Builds the SUMO net of a lane graph at `path`, in the frame of the graph.

    Raises:
        InputError: there are no lanelets, they do not add up, or netconvert is missing or refuses them.
    """
    plan = _Plan(graph)
    plain, outlines, lanes = _plain_xml(plan)
    options = ("--lefthand", "true") if graph.keeps_left else ()
    warnings = build_net(plain, path, options, outlines)
    connections = tuple(replace(link, name=f"{lanes[link.start]}{ARROW}{lanes[link.end]}") for link in plan.links)
    return BuiltNet((*graph.notes, *(f"netconvert: {warning}" for warning in warnings)), connections)


def _plain_xml(plan: _Plan) -> tuple[dict[str, ET.Element], dict[str, str], dict[str, str]]:
    """Returns the map as SUMO's plain XML.

    Lanes are numbered from the side to which traffic keeps, and edges named by the lanelet that lies there; junctions
    are named by a number.

    Returns:
        Nodes, edges and connections, by what they are; the outlines of the junctions; SUMO's lanes by lanelet.
    """
    nodes, edges, connections = ET.Element("nodes"), ET.Element("edges"), ET.Element("connections")
    by_node: dict[int, list[FloatArray]] = {}
    ends_at: dict[int, list[FloatArray]] = {}
    lines_at: dict[int, list[FloatArray]] = {}
    outlines: dict[str, str] = {}
    signals: set[int] = set()
    lanes: dict[str, str] = {}
    for row, group in enumerate(plan.groups):
        members = [plan.by_id[name] for name in group]
        lanes |= {name: f"{group[0]}_{index}" for index, name in enumerate(group)}
        middle = plan.line(group[0])
        if len(group) > 1:
            middle = 0.5 * (at_shares(middle, SHARES) + at_shares(plan.line(group[-1]), SHARES))
        ends = plan.node_of[row, 0], plan.node_of[row, 1]
        for node, vertex in zip(ends, (0, -1), strict=True):
            by_node.setdefault(node, []).append(middle[vertex])
            ends_at.setdefault(node, []).extend(corner for member in members for corner in member.ends(vertex))
            lines_at.setdefault(node, []).extend(member.centerline for member in members)
        signals |= {ends[1]} if any(member.lights for member in members) else set()
        attributes = {"id": group[0], "from": f"j{ends[0]}", "to": f"j{ends[1]}", "numLanes": str(len(group))}
        attributes |= {"speed": f"{max(member.speed_limit for member in members):.2f}", "spreadType": "center"}
        attributes |= {"shape": shape_text(middle), "priority": str(len(group))}
        edge = ET.SubElement(edges, "edge", attributes)
        for index, member in enumerate(members):
            shape = shape_text(plan.line(member.id))
            lane = {"index": str(index), "width": f"{member.width:.{DECIMALS}f}", "shape": shape}
            ET.SubElement(edge, "lane", lane)
    for link in plan.links:
        if any(plan.by_id[name].lights for name in link.inner):
            signals.add(plan.node_of[plan.group_of[link.start], 1])
    controlled = {plan.node_of[plan.group_of[link.start], 1] for link in plan.links if link.inner}
    for node, points in sorted(by_node.items()):
        place = dict(zip("xyz", (f"{value:.{DECIMALS}f}" for value in np.mean(points, axis=0)), strict=False))
        kind = "traffic_light" if node in signals & controlled else "priority" if len(points) > 1 else "dead_end"
        attributes = {"id": f"j{node}", **place, "type": kind, "radius": "0"}
        corners = np.array(ends_at[node])
        ET.SubElement(nodes, "node", {**attributes, "shape": shape_text(_clear_place(corners, lines_at[node]))})
        hull = shapely.MultiPoint(corners).convex_hull
        if kind != "dead_end" and hull.geom_type == "Polygon":
            outlines[f"j{node}"] = shape_text(np.asarray(hull.exterior.coords, np.float64)[:-1])
    for link in plan.links:
        connections.append(_connection(plan, link))
    return {"node": nodes, "edge": edges, "connection": connections}, outlines, lanes


def _clear_place(corners: FloatArray, lines: list[FloatArray]) -> FloatArray:
    """Returns a triangle (3, 2) of a centimetre that neither the lanes of a junction nor their extensions hit.

    netconvert cuts or lengthens lanes to where they meet the outline of their junction. Ours are already as long as
    they should be, so it is given an outline that they do not meet.
    """
    ways = shapely.union_all([shapely.LineString(extended(line, EXTENSION)) for line in lines])
    middle = corners.mean(axis=0)
    spread = np.linspace(-1.0, 1.0, 9)
    raster = np.stack(np.meshgrid(middle[0] + spread, middle[1] + spread), axis=-1).reshape(-1, 2)
    candidates = np.concatenate([corners, raster])
    x, y = candidates[int(np.argmax(shapely.distance(shapely.points(candidates), ways)))]
    return np.array([[x, y], [x + AREA_GAP, y], [x, y + AREA_GAP]])


SHARES: FloatArray = np.linspace(0.0, 1.0, 24)
"""At which the middle line of an edge is taken."""


def _connection(plan: _Plan, link: Connection) -> ET.Element:
    start, end = plan.groups[plan.group_of[link.start]], plan.groups[plan.group_of[link.end]]
    attributes = {"from": start[0], "to": end[0]}
    attributes |= {"fromLane": str(start.index(link.start)), "toLane": str(end.index(link.end))}
    if link.inner:
        lines = [plan.line(name) for name in link.inner]
        begin, finish = plan.line(link.start)[-1:], plan.line(link.end)[:1]
        attributes["shape"] = shape_text(without_repeats(np.concatenate([begin, *lines, finish])))
    return ET.Element("connection", attributes)


def _crossing_pairs(lanelets: list[Lanelet]) -> list[tuple[str, str]]:
    """Returns pairs of lanelets whose centre lines cross off their ends, other than where one leads into the other, or
    over it.
    """
    lines = [shapely.LineString(lanelet.centerline) for lanelet in lanelets]
    pairs = []
    for row, column in sorted(crossing_pairs(lines)):
        first, second = lanelets[row], lanelets[column]
        if row > column or second.id in first.successors or first.id in second.successors:
            continue
        if lines[row].hausdorff_distance(lines[column]) < ENDS_APART:  # one lane, driven in both directions
            continue
        ends = shapely.union(lines[row].boundary, lines[column].boundary)
        if any(
            ends.distance(point) > ENDS_APART and abs(first.height_at(point) - second.height_at(point)) < LEVEL
            for point in crossing_points(lines[row], lines[column])
        ):
            pairs.append((first.id, second.id))
    return pairs
