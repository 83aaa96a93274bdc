"""Connectivity of the lanes of a net: dead ends, unreachable lanes, missing links and crossing edges.

Hand-made nets often lack a link, or have lanes inside an intersection that are not marked as such. Both load without a
warning; this module finds the lanes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import shapely

from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_crossings import crossing_pairs, crossing_points
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import LEVEL, Lane

ABUTTING = 3.0  # [m] from the end of a lane within which another one that begins looks like its continuation
ABUTTING_ANGLE = np.deg2rad(45.0)  # and by which it may turn
BRIDGED = 6.0  # [m] from the end of a lane within which one that it leads to begins, if only to turn around
CROSSING_ANGLE = np.deg2rad(20.0)  # from which on edges cross; below they merge or part
CROSSING_MARGIN = 1.0  # [m] from the end of a lane, where lanes may touch


@dataclass(frozen=True)
class Crossing:
    """Two edges outside of junctions whose lanes cross, at x, y [m]."""

    one: str
    other: str
    x: float
    y: float


@dataclass(frozen=True)
class Gap:
    """A lane that begins where another one ends, at x, y [m], without being linked to it or to any other."""

    before: str
    lane: str
    x: float
    y: float


@dataclass(frozen=True)
class Connectivity:
    """What is missing or odd in how lanes follow each other; ids of lanes, ascending.

    Attributes:
        stuck: lanes on which vehicles come in (nothing leads to them) and from which no exit is reached by following
            the lanes, where one changes lanes only off a lane that ends early; in a closed net, none of an edge that
            others lead to.
        ending: lanes that end early: they lead nowhere while their edge goes on.
        unreached: lanes that cannot be reached from where vehicles come in, where one changes lanes only onto a lane
            that begins late; none in a closed net, which has no way in.
        beginning: lanes that begin late: nothing leads to them while it does to others of their edge.
        gaps: lanes into which nothing leads though another lane ends where they begin.
        apart: pairs of lanes of which one leads to the other, which begins elsewhere: the junction lacks lanes inside.
        crossings: edges that cross: inside a junction there should be connections, not edges; a bridge is none.
    """

    stuck: tuple[str, ...] = ()
    ending: tuple[str, ...] = ()
    unreached: tuple[str, ...] = ()
    beginning: tuple[str, ...] = ()
    gaps: tuple[Gap, ...] = ()
    apart: tuple[tuple[str, str], ...] = ()
    crossings: tuple[Crossing, ...] = ()

    @property
    def failures(self) -> list[str]:
        """A sentence for each lane or place at which traffic cannot flow as on a road."""
        missed = [f"lane {lane} leads to no exit" for lane in self.stuck]
        missed += [f"lane {lane} cannot be reached from where vehicles come in" for lane in self.unreached]
        missed += [
            f"lane {gap.lane} has no way in: lane {gap.before} ends where it begins, at ({gap.x:.1f}, {gap.y:.1f}), "
            "and does not lead to it"
            for gap in self.gaps
        ]
        if self.apart:
            missed.append(
                f"{len(self.apart)} lanes lead to one that begins more than {BRIDGED:g} m away, such as "
                f"{' to '.join(self.apart[0])}: build the net with lanes inside junctions (netconvert without "
                "--no-internal-links)"
            )
        missed += [
            f"edges {place.one} and {place.other} cross at ({place.x:.1f}, {place.y:.1f}) without a junction: mark "
            "their lanes there as lanes of an intersection; of a bridge, keep only one level in the recording"
            for place in self.crossings
        ]
        return missed


def connectivity(lane_map: LaneMap) -> Connectivity:
    """Checks the connectivity of the lanes of `lane_map`."""
    lanes = lane_map.lanes
    onwards = {lane.edge_id for lane in lanes if lane.successors}
    after = {lane.id: lane.successors for lane in lanes}
    before: dict[str, list[str]] = {lane.id: [] for lane in lanes}
    for lane in lanes:
        for name in lane.successors:
            before[name].append(lane.id)
    entered = {lane.edge_id for lane in lanes if before[lane.id]}
    ending = tuple(lane.id for lane in lanes if not lane.successors and lane.edge_id in onwards)
    beginning = tuple(lane.id for lane in lanes if not before[lane.id] and lane.edge_id in entered)
    leads_out = _closure({lane.id for lane in lanes if lane.edge_id not in onwards}, lanes, after, ending)
    comes_in = _closure({lane.id for lane in lanes if lane.edge_id not in entered}, lanes, before, beginning)
    return Connectivity(
        stuck=tuple(
            lane.id
            for lane in lanes
            if not before[lane.id] and lane.id not in leads_out and (leads_out or lane.edge_id not in entered)
        ),
        ending=ending,
        unreached=tuple(lane.id for lane in lanes if comes_in and lane.id not in comes_in),
        beginning=beginning,
        gaps=_gaps(lanes, {lane.id for lane in lanes if lane.edge_id not in entered}),
        apart=tuple(
            (lane.id, name)
            for lane in lanes
            for name in lane.successors
            if np.hypot(*(lanes[lane_map.row(name)].centerline[0] - lane.centerline[-1])) > BRIDGED
        ),
        crossings=_crossings(lanes),
    )


def _closure(
    origin: Collection[str], lanes: Collection[Lane], links: Mapping[str, Collection[str]], changing: Collection[str]
) -> set[str]:
    """Returns `origin` lanes, and all with a link to one of them or, of those in `changing`, a neighbour among them."""
    closure = set(origin)
    while True:
        more = {
            lane.id
            for lane in lanes
            if lane.id not in closure
            and (
                any(name in closure for name in links[lane.id])
                or (lane.id in changing and not {lane.left, lane.right}.isdisjoint(closure))
            )
        }
        if not more:
            return closure
        closure |= more


def _gaps(lanes: Collection[Lane], entries: Collection[str]) -> tuple[Gap, ...]:
    """Returns, for every lane of `entries` that begins at the end of another one, the one that ends nearest to it."""
    gaps = []
    ends = np.array([lane.centerline[-1] for lane in lanes])
    headings = np.array([_heading(lane, -1) for lane in lanes])
    edges = np.array([lane.edge_id for lane in lanes])
    names = [lane.id for lane in lanes]
    for lane in lanes:
        if lane.id not in entries:
            continue
        apart = np.hypot(*(ends - lane.centerline[0]).T)
        apart[np.abs(wrap_angle(headings - _heading(lane, 0))) > ABUTTING_ANGLE] = np.inf
        apart[edges == lane.edge_id] = np.inf
        nearest = int(apart.argmin())
        if apart[nearest] <= ABUTTING:
            gaps.append(Gap(names[nearest], lane.id, *(float(value) for value in lane.centerline[0])))
    return tuple(gaps)


def _crossings(lanes: Collection[Lane]) -> tuple[Crossing, ...]:
    """Returns where lanes of different edges outside of junctions cross, once for each pair of edges."""
    outside = [lane for lane in lanes if not lane.is_internal]
    lines = [shapely.LineString(lane.centerline) for lane in outside]
    crossings: dict[tuple[str, str], Crossing] = {}
    for i, j in sorted(crossing_pairs(lines)):
        pair = (outside[i].edge_id, outside[j].edge_id)
        if pair[0] >= pair[1] or pair in crossings:
            continue
        for point in crossing_points(lines[i], lines[j]):
            if _crosses(outside[i], outside[j], lines[i], lines[j], point):
                crossings[pair] = Crossing(*pair, float(point.x), float(point.y))
                break
    return tuple(crossings.values())


def _crosses(a: Lane, b: Lane, line_a: shapely.LineString, line_b: shapely.LineString, point: shapely.Point) -> bool:
    """Returns whether two lanes cross at `point`, at an angle, off their ends and at one height."""
    headings, heights = [], []
    for lane, line in ((a, line_a), (b, line_b)):
        s = float(line.project(point))
        if not CROSSING_MARGIN < s < lane.length - CROSSING_MARGIN:
            return False
        headings.append(_heading(lane, int(np.searchsorted(lane.s, s, side="right")) - 1))
        heights.append(0.0 if lane.heights is None else float(np.interp(s, lane.s, lane.heights)))
    if abs(heights[0] - heights[1]) >= LEVEL:
        return False
    turn = abs(float(wrap_angle(np.array(headings[0] - headings[1]))))
    return CROSSING_ANGLE < turn < np.pi - CROSSING_ANGLE


def _heading(lane: Lane, segment: int) -> float:
    """Returns the direction [rad] of a segment of the centre line."""
    steps: FloatArray = np.diff(lane.centerline, axis=0)
    return float(np.arctan2(steps[segment, 1], steps[segment, 0]))
