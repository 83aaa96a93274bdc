"""Lanelet maps as SUMO nets.

A lanelet is a piece of one lane between a left and a right bound. Lanelets side by side become one edge whose lanes
keep their own centre lines; lanelets inside intersections, where they cross or split, become connections with the
lanelet's centre line as their shape. Readers: :mod:`litsim_data.maps.commonroad`, :mod:`litsim_data.maps.lanelet2_osm`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import shapely

from litsim_data.maps.netconvert import DECIMALS, build_net
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_crossings import crossing_pairs, crossing_points

SPEED_LIMIT = 13.89  # [m/s] 50 km/h, where the map gives none
INNER_LENGTH_MAX = 60.0  # [m] longer lanelets that split or join are ramps, not turns
ENDS_APART = 1.0  # [m] centre lines that come nearer than this only at their ends follow each other
ROUNDS_MAX = 50
AREA_GAP = 0.01  # [m] size of the outline that netconvert is given of a junction
EXTENSION = 110.0  # [m] netconvert looks 100 m ahead of a lane for its junction
SAMPLES_MIN = 8  # points of a centre line, at least
SAMPLE = 2.0  # [m] between them
LONGEST = 100_000.0  # [m] of a lanelet


@dataclass(frozen=True)
class Lanelet:
    """A piece of lane.

    Attributes:
        id: unique.
        left, right: (k, 2), (l, 2) bounds in driving direction [m].
        successors: ids of those that begin where this one ends; unknown ids are ignored.
        left_id, right_id: ids of neighbours in the same direction.
        speed_limit: [m/s].
        signal: traffic lights hold at its end.
        junction: whether the map says that it lies inside an intersection.
    """

    id: str
    left: FloatArray
    right: FloatArray
    successors: tuple[str, ...] = ()
    left_id: str | None = None
    right_id: str | None = None
    speed_limit: float = SPEED_LIMIT
    signal: bool = False
    junction: bool = False

    @cached_property
    def _sides(self) -> tuple[FloatArray, FloatArray]:
        """Both bounds at the same shares of their length (m, 2)."""
        length = max(_length(self.left), _length(self.right))
        share = np.linspace(0.0, 1.0, max(SAMPLES_MIN, int(np.ceil(length / SAMPLE)) + 1))
        return at_shares(self.left, share), at_shares(self.right, share)

    @cached_property
    def centerline(self) -> FloatArray:
        """The points (m, 2) [m] midway between the bounds."""
        left, right = self._sides
        return 0.5 * (left + right)

    def ends(self, at: int) -> FloatArray:
        """Returns the points (2, 2) [m] of the left and the right bound at the start (`at` 0) or the end (`at` -1)."""
        return np.stack([self.left[at], self.right[at]])

    @cached_property
    def width(self) -> float:
        """Median distance between the bounds [m]."""
        left, right = self._sides
        return float(np.median(np.hypot(*(left - right).T)))

    @cached_property
    def length(self) -> float:
        """Length of the centre line [m]."""
        return _length(self.centerline)


@dataclass(frozen=True)
class _Link:
    """From one outer lanelet to another; `inner` are the lanelets between them."""

    start: str
    end: str
    inner: tuple[str, ...]


class _Plan:
    """Which lanelets are edges' lanes, which are connections, and which ends meet in a junction."""

    def __init__(self, lanelets: Iterable[Lanelet]) -> None:
        self.by_id = {lanelet.id: lanelet for lanelet in lanelets}
        if not self.by_id:
            raise InputError("the map holds no lanelets")
        for lanelet in self.by_id.values():
            reach = float(np.ptp(np.concatenate([lanelet.left, lanelet.right]), axis=0).max())
            if reach > LONGEST:
                raise InputError(
                    f"lanelet {lanelet.id} is {reach / 1e3:.6g} km long, expected at most {LONGEST / 1e3:g}"
                )
        self.after = {
            name: tuple(other for other in lanelet.successors if other in self.by_id and other != name)
            for name, lanelet in self.by_id.items()
        }
        self.before: dict[str, list[str]] = {name: [] for name in self.by_id}
        for name, following in self.after.items():
            for other in following:
                self.before[other].append(name)
        self.crossing = _crossing_pairs(list(self.by_id.values()), self.after)
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
                return
            self.inner = inner
        raise InputError("the lanelets do not add up to roads and junctions")

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
        outer = [name for name in self.by_id if name not in self.inner]
        left_of: dict[str, str] = {}
        for name in outer:
            lanelet = self.by_id[name]
            if lanelet.left_id in self.by_id and lanelet.left_id not in self.inner and lanelet.left_id is not None:
                left_of.setdefault(name, lanelet.left_id)
            if lanelet.right_id in self.by_id and lanelet.right_id not in self.inner and lanelet.right_id is not None:
                left_of.setdefault(lanelet.right_id, name)
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

    def _links(self) -> Iterator[_Link]:
        for name in self.group_of:
            stack: list[tuple[str, ...]] = [(other,) for other in self.after[name]]
            while stack:
                path = stack.pop()
                if path[-1] not in self.inner:
                    yield _Link(name, path[-1], path[:-1])
                else:
                    stack += [(*path, other) for other in self.after[path[-1]] if other not in path]

    def _nodes(self) -> dict[tuple[int, int], int]:
        """Returns the junction of each group's start (row, 0) and end (row, 1): ends that are linked, or whose links
        cross, meet.
        """
        parent: dict[tuple[int, int] | str, tuple[int, int] | str] = {}

        def root(item: tuple[int, int] | str) -> tuple[int, int] | str:
            parent.setdefault(item, item)
            while parent[item] != item:
                parent[item] = parent[parent[item]]
                item = parent[item]
            return item

        for row in range(len(self.groups)):
            root((row, 0)), root((row, 1))
        for link in self.links:
            end = (self.group_of[link.start], 1)
            parent[root((self.group_of[link.end], 0))] = root(end)
            for name in link.inner:
                parent[root(name)] = root(end)
        for one, other in self.crossing:
            if one in self.inner and other in self.inner:
                parent[root(one)] = root(other)
        numbers: dict[tuple[int, int] | str, int] = {}
        ends = [(row, side) for row in range(len(self.groups)) for side in (0, 1)]
        return {end: numbers.setdefault(root(end), len(numbers)) for end in ends}


def write_lanelets(lanelets: Iterable[Lanelet], path: Path) -> list[str]:
    """Builds the SUMO net of a lanelet map at `path`, in the frame of the map.

    Returns:
        netconvert's warnings.

    Raises:
        InputError: there are no lanelets, they do not add up, or netconvert is missing or refuses them.
    """
    plain, outlines = lanelets_plain_xml(lanelets)
    return build_net(plain, path, outlines=outlines)


def lanelets_plain_xml(lanelets: Iterable[Lanelet]) -> tuple[dict[str, ET.Element], dict[str, str]]:
    """Returns the map as SUMO's plain XML.

    Edges are named by the id of their rightmost lanelet, junctions by a number.

    Returns:
        Nodes, edges and connections by file name, and the outlines of the junctions.

    Raises:
        InputError: there are no lanelets, or they do not add up.
    """
    plan = _Plan(lanelets)
    nodes, edges, connections = ET.Element("nodes"), ET.Element("edges"), ET.Element("connections")
    by_node: dict[int, list[FloatArray]] = {}
    ends_at: dict[int, list[FloatArray]] = {}
    lines_at: dict[int, list[FloatArray]] = {}
    outlines: dict[str, str] = {}
    signals: set[int] = set()
    for row, group in enumerate(plan.groups):
        members = [plan.by_id[name] for name in group]
        middle = 0.5 * (at_shares(members[0].centerline, SHARES) + at_shares(members[-1].centerline, SHARES))
        ends = plan.node_of[row, 0], plan.node_of[row, 1]
        for node, at in zip(ends, (0, -1), strict=True):
            by_node.setdefault(node, []).append(middle[at])
            ends_at.setdefault(node, []).extend(corner for member in members for corner in member.ends(at))
            lines_at.setdefault(node, []).extend(member.centerline for member in members)
        signals |= {ends[1]} if any(member.signal for member in members) else set()
        attributes = {"id": group[0], "from": f"j{ends[0]}", "to": f"j{ends[1]}", "numLanes": str(len(group))}
        attributes |= {"speed": f"{max(member.speed_limit for member in members):.2f}", "spreadType": "center"}
        attributes |= {"shape": _shape(middle), "priority": str(len(group))}
        edge = ET.SubElement(edges, "edge", attributes)
        for index, member in enumerate(members):
            lane = {"index": str(index), "width": f"{member.width:.{DECIMALS}f}", "shape": _shape(member.centerline)}
            ET.SubElement(edge, "lane", lane)
    controlled = {plan.node_of[plan.group_of[link.start], 1] for link in plan.links if link.inner}
    for node, points in sorted(by_node.items()):
        x, y = np.mean(points, axis=0)
        kind = "traffic_light" if node in signals & controlled else "priority" if len(points) > 1 else "dead_end"
        attributes = {"id": f"j{node}", "x": f"{x:.{DECIMALS}f}", "y": f"{y:.{DECIMALS}f}", "type": kind, "radius": "0"}
        corners = np.array(ends_at[node])
        ET.SubElement(nodes, "node", {**attributes, "shape": _shape(_clear_place(corners, lines_at[node]))})
        hull = shapely.MultiPoint(corners).convex_hull
        if kind != "dead_end" and hull.geom_type == "Polygon":
            outlines[f"j{node}"] = _shape(np.asarray(hull.exterior.coords, np.float64)[:-1])
    for link in plan.links:
        connections.append(_connection(plan, link))
    return {"map.nod.xml": nodes, "map.edg.xml": edges, "map.con.xml": connections}, outlines


def _clear_place(corners: FloatArray, lines: list[FloatArray]) -> FloatArray:
    """Returns a triangle (3, 2) of a centimetre that neither the lanes of a junction nor their extensions hit.

    netconvert cuts or lengthens lanes to where they meet the outline of their junction. Ours are already as long as
    they should be, so it is given an outline that they do not meet.
    """
    extended = shapely.union_all([shapely.LineString(_extended(line)) for line in lines])
    middle = corners.mean(axis=0)
    spread = np.linspace(-1.0, 1.0, 9)
    raster = np.stack(np.meshgrid(middle[0] + spread, middle[1] + spread), axis=-1).reshape(-1, 2)
    candidates = np.concatenate([corners, raster])
    x, y = candidates[int(np.argmax(shapely.distance(shapely.points(candidates), extended)))]
    return np.array([[x, y], [x + AREA_GAP, y], [x, y + AREA_GAP]])


def _extended(line: FloatArray) -> FloatArray:
    """Returns `line` (k, 2), straight on at both ends for as far as netconvert looks."""
    head, tail = line[0] - line[1], line[-1] - line[-2]
    before, after = (end + EXTENSION * way / np.hypot(*way) for end, way in ((line[0], head), (line[-1], tail)))
    return np.vstack([before, line, after])


SHARES: FloatArray = np.linspace(0.0, 1.0, 24)
"""At which the middle line of an edge is taken."""


def _connection(plan: _Plan, link: _Link) -> ET.Element:
    start, end = plan.groups[plan.group_of[link.start]], plan.groups[plan.group_of[link.end]]
    attributes = {"from": start[0], "to": end[0]}
    attributes |= {"fromLane": str(start.index(link.start)), "toLane": str(end.index(link.end))}
    if link.inner:
        lines = [plan.by_id[name].centerline for name in link.inner]
        begin, finish = plan.by_id[link.start].centerline[-1:], plan.by_id[link.end].centerline[:1]
        attributes["shape"] = _shape(_without_repeats(np.concatenate([begin, *lines, finish])))
    return ET.Element("connection", attributes)


def _crossing_pairs(lanelets: list[Lanelet], after: dict[str, tuple[str, ...]]) -> list[tuple[str, str]]:
    """Returns pairs of lanelets whose centre lines cross off their ends, other than where one leads into the other."""
    lines = [shapely.LineString(lanelet.centerline) for lanelet in lanelets]
    pairs = []
    for row, column in sorted(crossing_pairs(lines)):
        one, other = lanelets[row].id, lanelets[column].id
        if row > column or other in after[one] or one in after[other]:
            continue
        ends = shapely.union(lines[row].boundary, lines[column].boundary)
        if any(ends.distance(point) > ENDS_APART for point in crossing_points(lines[row], lines[column])):
            pairs.append((one, other))
    return pairs


def _length(line: FloatArray) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def at_shares(line: FloatArray, share: FloatArray) -> FloatArray:
    """Returns points (m, 2) of a polyline at shares (m,) of its length."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    return np.column_stack([np.interp(share * s[-1], s, line[:, axis]) for axis in (0, 1)])


def _without_repeats(line: FloatArray) -> FloatArray:
    keep = np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 1e-3])
    return line[keep]


def _shape(line: FloatArray) -> str:
    return " ".join(f"{x:.{DECIMALS}f},{y:.{DECIMALS}f}" for x, y in line)
