"""Roads of an OpenDRIVE map: where places lie that are given by road, lane and distance, and how lanes lead on.

Nets come from netconvert (:mod:`.netconvert`), which keeps no such coordinates.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.netconvert import LEFT_HAND, unruled
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import number_in, read_plain_xml

SAMPLE = 2.0  # [m] between points of reference lines that positions are compared with
STEP = 1.0  # [m] between points of ways along lanes
REACH = 60.0  # [m] from its reference line, at most, of a lane
LONGEST = 1e5  # [m] of a road
LARGEST = 1e9
"""Magnitude of numbers, at most."""
ROUNDS = 4  # of projecting a point on a reference line
SPEEDS = {"km/h": 1.0 / 3.6, "mph": 0.44704}
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
NO_LANES = {"none", "sidewalk", "walking", "curb", "border", "median", "restricted"}
"""Types of lanes that nobody drives along."""
Pose = tuple[float, float, float]
"""x, y [m] and heading [rad]."""


@dataclass(frozen=True)
class Polynomials:
    """Cubic polynomials, each valid from where it begins: rows of beginning, a, b, c and d."""

    rows: Sequence[tuple[float, ...]]

    def at(self, s: float) -> float:
        """Returns the value at `s`; 0 before the first polynomial, and without any."""
        row = bisect_right(self.rows, s, key=itemgetter(0)) - 1
        if row < 0:
            return 0.0
        begin, a, b, c, d = self.rows[row]
        u = s - begin
        return a + u * (b + u * (c + u * d))


@dataclass(frozen=True)
class RoadLane:
    """A lane within one section of a road.

    Attributes:
        type: as the map says.
        width: by the distance from the beginning of the section [m].
        before, after: number of the lane that it continues towards lower and higher s; None if none.
    """

    type: str
    width: Polynomials
    before: int | None
    after: int | None


@dataclass(frozen=True)
class Section:
    """A section of a road: its beginning [m], and its lanes by their numbers."""

    s: float
    lanes: dict[int, RoadLane]


@dataclass(frozen=True)
class Link:
    """What follows a road: the kind of element, its id, and the end of it that touches."""

    kind: str
    id: str
    contact: str


@dataclass(frozen=True)
class Place:
    """A place on a road: distance along its reference line, distance to the left of it [m], and the lane."""

    road: Road
    s: float
    t: float
    lane: int

    @property
    def pose(self) -> Pose:
        """Where it is, headed along the reference line."""
        return self.road.pose(self.s, self.t)


@dataclass(frozen=True, eq=False)
class Road:
    """A road.

    Attributes:
        id, length: as the map says [m].
        left_hand: whether traffic keeps to the left.
        pieces: elements of the reference line, ascending.
        offset: distance of the lanes' middle from the reference line.
        sections: ascending.
        before, after: what it begins and ends at.
        junction: whether it connects others at a junction.
        speed: speed limit at its beginning [m/s]; None where the map has none.
    """

    id: str
    length: float
    left_hand: bool
    pieces: list[ET.Element]
    offset: Polynomials
    sections: list[Section]
    before: Link | None
    after: Link | None
    junction: bool
    speed: float | None

    def pose(self, s: float, t: float = 0.0) -> Pose:
        """Returns where the point `s` along the reference line and `t` to its left is [m], headed along the line."""
        row = max(bisect_right(self._starts, s) - 1, 0)
        piece = self.pieces[row]
        u, v, turned = _within(piece, s - self._starts[row])
        x, y, heading = (_float(piece, name) for name in ("x", "y", "hdg"))
        cos, sin = math.cos(heading), math.sin(heading)
        ahead = heading + turned
        x, y = x + cos * u - sin * v, y + sin * u + cos * v
        return x - t * math.sin(ahead), y + t * math.cos(ahead), ahead

    def section(self, s: float) -> Section:
        """Returns the section at a distance `s` along the road [m]."""
        return self.sections[max(bisect_right(self.sections, s, key=lambda section: section.s) - 1, 0)]

    def middle(self, lane: int, s: float) -> tuple[float, float] | None:
        """Returns how far left of the reference line the middle of a lane is at `s` [m], and the lane's width [m].

        Lane 0 is the line that lanes are counted from. The result is None where the road has no such lane.
        """
        section, side = self.section(s), 1 if lane > 0 else -1
        inner = [section.lanes.get(number) for number in range(side, lane + side, side)] if lane else []
        if None in inner:
            return None
        widths = [part.width.at(s - section.s) for part in inner if part is not None] or [0.0]
        return self.offset.at(s) + side * (sum(widths) - 0.5 * widths[-1]), widths[-1]

    def lane_at(self, s: float, t: float) -> int | None:
        """Returns the number of the lane at a place, None where the road has none that vehicles may use."""
        for number, lane in sorted(self.section(s).lanes.items()):
            place = self.middle(number, s)
            if place and lane.type not in NO_LANES and abs(t - place[0]) <= 0.5 * place[1]:
                return number
        return None

    def leads(self, lane: int) -> bool:
        """Returns whether traffic on a lane drives along the reference line, not against it."""
        return (lane > 0) == self.left_hand

    @cached_property
    def _starts(self) -> list[float]:
        return [_float(piece, "s") for piece in self.pieces]

    @cached_property
    def samples(self) -> FloatArray:
        """Points (n, 3) of the reference line: s, x and y [m]."""
        count = max(math.ceil(self.length / SAMPLE), 1)
        return np.array([(s, *self.pose(s)[:2]) for s in np.linspace(0.0, self.length, count + 1).tolist()])

    def project(self, x: float, y: float) -> tuple[float, float]:
        """Returns s and t [m] of a point, by the nearest point of the reference line."""
        row = np.hypot(self.samples[:, 1] - x, self.samples[:, 2] - y).argmin()
        s, t = float(self.samples[row, 0]), 0.0
        for _ in range(ROUNDS):
            at_x, at_y, heading = self.pose(s)
            cos, sin = math.cos(heading), math.sin(heading)
            t = cos * (y - at_y) - sin * (x - at_x)
            s = min(max(s + cos * (x - at_x) + sin * (y - at_y), 0.0), self.length)
        return s, t


class Roads:
    """The roads of an OpenDRIVE map.

    Raises:
        InputError: the file is no OpenDRIVE, or a road in it is malformed.
    """

    def __init__(self, path: Path) -> None:
        root = read_plain_xml(path, "OpenDRIVE file")
        try:
            self.by_id = {road.id: road for road in map(_road, root.findall("road"))}
            for element in unruled(root):
                road = self.by_id[element.get("id", "")]
                joined = self.by_id.get(road.before.id) if road.before else None
                self.by_id[road.id] = replace(road, left_hand=road.left_hand if joined is None else joined.left_hand)
            self._connections = list(_connections(root))
            for road in self.by_id.values():
                for piece in road.pieces:  # whose numbers are read where they are needed
                    road.pose(_float(piece, "s"))
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}: {error}") from error

    def place(self, x: float, y: float, heading: float) -> Place | None:
        """Returns the place on a lane at a point [m]; of several, that whose traffic drives most nearly as headed."""
        best, least = None, math.inf
        for road in self.by_id.values():
            near = np.hypot(road.samples[:, 1] - x, road.samples[:, 2] - y).min()
            if near > REACH:
                continue
            s, t = road.project(x, y)
            lane = road.lane_at(s, t)
            if lane is None:
                continue
            turned = heading - road.pose(s)[2] + (0.0 if road.leads(lane) else math.pi)
            off = abs(float(wrap_angle(np.array(turned))))
            if off < least - 1e-6:
                best, least = Place(road, s, t, lane), off
        return best

    def way(self, place: Place, heading: float, length: float) -> FloatArray:
        """Returns poses (n, 3) along the lane from a place on, and those that follow it: x, y [m] and heading [rad].

        It ends where no lane follows. At a junction it is that which turns least.

        Args:
            place: where it begins.
            heading: direction [rad] in which it leads, along the lane or against it.
            length: of the way, at most [m].
        """
        road, lane, s = place.road, place.lane, place.s
        forward = math.cos(heading - road.pose(s)[2]) > 0.0
        middle = road.middle(lane, s)
        aside = 0.0 if middle is None else (place.t - middle[0]) * (1 if forward else -1)
        poses: list[Pose] = []
        left = length
        while left > 0.0:
            section = road.section(s if forward else max(s - 1e-6, 0.0))
            end = end_of(road, section) if forward else section.s
            for along in _steps(s, end, left):
                station = min(max(along, section.s), end_of(road, section) - 1e-9)
                found = road.middle(lane, station)
                if found is None:
                    return np.array(poses).reshape(-1, 3)
                x, y, ahead = road.pose(along, found[0] + (aside if forward else -aside))
                poses.append((x, y, ahead if forward else ahead + math.pi))
            left -= max(abs(end - s), STEP)
            onward = self.onward(road, lane, section, forward=forward)
            if not onward:
                break
            road, lane, s, forward = onward[0]
        return np.array(poses).reshape(-1, 3)

    def onward(self, road: Road, lane: int, section: Section, *, forward: bool) -> list[Onward]:
        """Returns what follows a lane of a section; at a junction that first which turns least."""
        here = section.lanes.get(lane)
        number = None if here is None else here.after if forward else here.before
        row = road.sections.index(section) + (1 if forward else -1)
        if 0 <= row < len(road.sections):
            s = road.sections[row].s if forward else section.s
            return [] if number not in road.sections[row].lanes else [(road, int(number or 0), s, forward)]
        link = road.after if forward else road.before
        if link is None:
            return []
        if link.kind == "junction":
            return self._across(link.id, road, lane)
        other = self.by_id.get(link.id)
        if other is None or number is None:
            return []
        starts = link.contact == "start"
        return [(other, number, 0.0 if starts else other.length, starts)]

    def _across(self, junction: str, road: Road, lane: int) -> list[Onward]:
        """Returns what follows a lane at a junction, that first which turns least."""
        options: list[tuple[float, int, Onward]] = []
        for where, incoming, name, contact, lanes in self._connections:
            other = self.by_id.get(name)
            if (where, incoming) == (junction, road.id) and other is not None and lane in lanes:
                turned = other.pose(other.length)[2] - other.pose(0.0)[2]
                starts = contact == "start"
                onward = (other, lanes[lane], 0.0 if starts else other.length, starts)
                options.append((abs(float(wrap_angle(np.array(turned)))), len(options), onward))
        return [onward for *_, onward in sorted(options)]


Onward = tuple[Road, int, float, bool]
"""Road, lane, beginning [m] and direction of what follows a lane: along the reference line, or against it."""


def end_of(road: Road, section: Section) -> float:
    """Returns where a section ends [m]."""
    row = road.sections.index(section) + 1
    return road.sections[row].s if row < len(road.sections) else road.length


def _steps(begin: float, end: float, most: float) -> list[float]:
    """Returns distances along a road from its place `begin` towards `end`, at most `most` on [m]."""
    reach = min(abs(end - begin), most)
    return np.linspace(begin, begin + math.copysign(reach, end - begin), max(math.ceil(reach / STEP), 1) + 1).tolist()


def _road(element: ET.Element) -> Road:
    name, length = element.get("id", ""), _float(element, "length")
    pieces = sorted(element.findall("planView/geometry"), key=lambda piece: _float(piece, "s"))
    sections = [
        Section(_float(section, "s"), {int(lane.get("id", "")): _lane(lane) for lane in section.findall("*/lane")})
        for section in element.findall("lanes/laneSection")
    ]
    if not pieces or not sections or not 0.0 < length <= LONGEST:
        raise ValueError(f"road {name} has no geometry, no laneSection or no length up to {LONGEST:g} m")
    return Road(
        name,
        length,
        element.get("rule") == LEFT_HAND,
        pieces,
        _polynomials(element.findall("lanes/laneOffset"), "s"),
        sorted(sections, key=lambda section: section.s),
        _link(element.find("link/predecessor")),
        _link(element.find("link/successor")),
        element.get("junction", "-1") != "-1",
        _limit(element.find("type/speed")),
    )


def _limit(element: ET.Element | None) -> float | None:
    if element is None or element.get("max") in ("no limit", "undefined"):
        return None
    return _float(element, "max") * SPEEDS.get(element.get("unit", "m/s"), 1.0)


def _lane(element: ET.Element) -> RoadLane:
    links = [element.find(f"link/{name}") for name in ("predecessor", "successor")]
    before, after = (None if link is None else int(link.get("id", "")) for link in links)
    return RoadLane(element.get("type", ""), _polynomials(element.findall("width"), "sOffset"), before, after)


def _link(element: ET.Element | None) -> Link | None:
    if element is None:
        return None
    return Link(element.get("elementType", ""), element.get("elementId", ""), element.get("contactPoint", ""))


def _connections(root: ET.Element) -> Iterator[tuple[str, str, str, str, dict[int, int]]]:
    """Yields junction, incoming and connecting road, end of the latter that touches, and lanes of each connection."""
    for junction in root.findall("junction"):
        for connection in junction.findall("connection"):
            lanes = {int(link.get("from", "")): int(link.get("to", "")) for link in connection.findall("laneLink")}
            road = connection.get("connectingRoad") or connection.get("linkedRoad") or ""
            yield (
                junction.get("id", ""),
                connection.get("incomingRoad", ""),
                road,
                connection.get("contactPoint", ""),
                lanes,
            )


def _polynomials(elements: list[ET.Element], begin: str) -> Polynomials:
    return Polynomials(
        sorted(tuple(_float(element, name) for name in (begin, "a", "b", "c", "d")) for element in elements)
    )


def _within(piece: ET.Element, s: float) -> Pose:
    """Returns the place `s` along an element of a reference line [m], seen from the element's beginning."""
    shape = piece[0] if len(piece) else piece
    if shape.tag in ("arc", "spiral"):
        names = ("curvature", "curvature") if shape.tag == "arc" else ("curvStart", "curvEnd")
        first, last = (_float(shape, name) for name in names)
        growth = (last - first) / max(_float(piece, "length"), 1e-9)
        along = 0.5 * s * (NODES + 1.0)
        turned = along * (first + 0.5 * growth * along)
        u, v = (0.5 * s * float(WEIGHTS @ wave(turned)) for wave in (np.cos, np.sin))
        return u, v, s * (first + 0.5 * growth * s)
    if shape.tag == "paramPoly3":
        scale = 1.0 if shape.get("pRange") == "arcLength" else 1.0 / max(_float(piece, "length"), 1e-9)
        (u, du), (v, dv) = (_cubic(shape, axis, s * scale) for axis in ("U", "V"))
        return u, v, math.atan2(dv, du)
    if shape.tag == "poly3":
        v, dv = _cubic(shape, "", s)
        return s, v, math.atan(dv)
    return s, 0.0, 0.0


def _cubic(shape: ET.Element, axis: str, p: float) -> tuple[float, float]:
    """Returns value and slope of a cubic polynomial."""
    a, b, c, d = (_float(shape, f"{name}{axis}") for name in "abcd")
    return a + p * (b + p * (c + p * d)), b + p * (2.0 * c + 3.0 * p * d)


def _float(element: ET.Element, name: str) -> float:
    """Returns an attribute as a number; raises ValueError if it is missing, or no such number."""
    return number_in(element, name, LARGEST)
