"""The lanes of a SUMO net as plain data, in frame map: metres of the net, x right, y up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET
from xml.sax import SAXException, SAXParseException, parse

import numpy as np
import sumolib

from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import arc_lengths
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import TREE_MAX, open_input

UNREADABLE = (SAXException, OSError, KeyError, ValueError, AttributeError, TypeError, IndexError)
"""Exceptions that sumolib raises for files that are damaged or not nets."""

MOST_KM2 = 2000  # of the rectangle around a net, whose lookup grid then takes about 1 GB
TOLERANCE = 1e-3  # [m] coordinates of a net are rounded to this
STOP_SIGNS = ("s", "w")  # SUMO's states of connections: stop, and stop on all ways
LEVEL = 3.0  # [m] of height between lanes that cross, from which on one passes over the other
GIVES_WAY = "mso"  # SUMO's states of connections: minor road, stop sign, minor at a light


@dataclass(frozen=True)
class Lane:
    """One lane.

    Attributes:
        id, edge_id: SUMO's names.
        index: position in its edge, 0 is the rightmost; in nets of left-hand traffic SUMO counts from the left.
        width: [m].
        speed_limit: [m/s].
        centerline: (k, 2) in driving direction [m].
        s: (k,) arc length of the vertices, from 0 [m].
        length: [m].
        successors: ids of the lanes that follow directly; where a junction has internal lanes, those.
        left, right: ids of the neighbours in the same edge, None at its borders.
        is_internal: inside a junction.
        heights: (k,) of the vertices [m]; None for a flat net.
        stops: ids of those successors before which a stop sign stands.
        gives_way: those of `successors` inside a junction on which a vehicle has to give way, by the signs, or by
            permissive green.
    """

    id: str
    edge_id: str
    index: int
    width: float
    speed_limit: float
    centerline: FloatArray
    s: FloatArray
    length: float
    successors: tuple[str, ...]
    left: str | None
    right: str | None
    is_internal: bool
    heights: FloatArray | None = None
    stops: tuple[str, ...] = ()
    gives_way: tuple[str, ...] = ()

    @property
    def junction(self) -> str:
        """SUMO's id of the junction that it is inside of, after which its edge is named (``:J_3``); empty outside."""
        return self.edge_id[1:].rpartition("_")[0] if self.is_internal else ""

    @property
    def headings(self) -> tuple[float, float]:
        """Headings of the centre line where it begins and where it ends [rad]."""
        along = np.diff(self.centerline, axis=0)[[0, -1]]
        begin, end = np.arctan2(along[:, 1], along[:, 0]).tolist()
        return begin, end


def lanes_from_left(lanes: Sequence[Lane]) -> list[int]:
    """Returns the numbers of `lanes` counted from the left of their edges, 1 first; 0 inside junctions.

    Lanes that are not among them, such as footpaths to the right, have positions in their edges all the same.
    """
    count: dict[str, int] = {}
    for lane in lanes:
        count[lane.edge_id] = max(count.get(lane.edge_id, 0), lane.index + 1)
    return [0 if lane.is_internal else count[lane.edge_id] - lane.index for lane in lanes]


def read_lanes(path: Path) -> list[Lane]:
    """Returns the lanes of a SUMO net that cars may use, inside junctions, too; raises as :func:`read_net`."""
    return read_net(path)[1]


def unreadable_net(path: Path, error: Exception) -> InputError:
    """Returns an error about the file at `path`, which is not a SUMO net, with the place at which sumolib failed."""
    if not isinstance(error, SAXException | OSError) and (tag := _root(path).tag) != "net":
        return InputError(f"{path}: not a SUMO net: its root element is <{tag}>, expected <net>")
    if isinstance(error, SAXParseException):
        why = f"line {error.getLineNumber()}, column {(error.getColumnNumber() or 0) + 1}: {error.getMessage()}"
    else:
        why = f"attribute {error} is missing" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
    return InputError(f"{path}: not a readable SUMO net: {why}")


def parse_net(path: Path, *, programs: bool = False) -> Any:
    """Returns a SUMO net as sumolib reads it, with internal lanes, and with the programs of lights on request.

    Raises:
        InputError: the file cannot be opened, as by :func:`litsim_sim.io.input_files.open_input`.
        one of UNREADABLE: it is no net.
    """
    # Of internal lanes that it skips, sumolib takes the parameters for those of a program, and fails.
    reader = sumolib.net.NetReader(withInternal=True, withPrograms=programs)
    with open_input(path, "net", size_max=TREE_MAX) as file:
        parse(file, reader)  # noqa: S317  of users, by a parser without network access that bounds entities
    return reader.getNet()


def read_net(path: Path) -> tuple[Any, list[Lane]]:
    """Returns a SUMO net as sumolib reads it, and its lanes for cars; raises InputError if it is none, or has none."""
    try:
        net = parse_net(path)
        edges = net.getEdges(withInternal=True)
        left_hand = _root(path).get("lefthand") == "true"
        lanes = [_lane(lane, left_hand, path) for edge in edges for lane in edge.getLanes() if _drivable(lane)]
    except UNREADABLE as error:
        raise unreadable_net(path, error) from error
    if not lanes:
        raise InputError(f"{path}: the net holds no lanes for cars; its root element is <{_root(path).tag}>")
    _check_extent(lanes, path)
    ids = {lane.id for lane in lanes}
    for lane in lanes:
        if lost := [name for name in lane.successors if name not in ids]:
            raise InputError(f"{path}: lane {lane.id} leads to unknown lanes {lost}")
    return net, lanes


def _check_extent(lanes: Sequence[Lane], path: Path) -> None:
    """Refuse a net too large for its lookup grid, as with a lane far from all others."""
    points = np.concatenate([lane.centerline for lane in lanes])
    extent = np.ptp(points, axis=0) / 1e3
    if extent.prod() > MOST_KM2:
        away = [np.abs(lane.centerline - np.median(points, axis=0)).max() for lane in lanes]
        raise InputError(
            f"{path}: the net covers {extent[0]:.6g} km by {extent[1]:.6g} km, expected at most {MOST_KM2} km2: cut it "
            f"to where the traffic is (netconvert --keep-edges.in-boundary); lane {lanes[int(np.argmax(away))].id} is "
            f"farthest from the middle"
        )


def _drivable(lane: Any) -> bool:
    """Returns whether cars may use a lane: no footpaths, crossings or rails."""
    return bool(lane.allows("passenger"))


def _root(path: Path) -> ET.Element:
    """Returns the root element of a net, whose attributes sumolib does not tell."""
    with open_input(path) as file:
        _, root = next(iter(ET.iterparse(file, ("start",))))  # noqa: S314  sumolib has read all of it before
    return root


def _lane(lane: Any, left_hand: bool, path: Path) -> Lane:
    """Returns a lane as sumolib reads it from `path`; raises InputError if its shape or its width is none."""
    shape = lane.getShape3D()
    centerline = np.array([point[:2] for point in shape], np.float64)
    heights = np.array([point[2] for point in shape], np.float64)
    if len(centerline) < 2 or not np.isfinite(centerline).all():
        raise InputError(f"{path}: lane {lane.getID()}: field shape has no two points with finite coordinates")
    if not 0.0 < lane.getWidth() < np.inf:
        raise InputError(f"{path}: lane {lane.getID()}: field width is {lane.getWidth():g}, expected more than 0")
    steps = np.hypot(*np.diff(centerline, axis=0).T)
    keep = np.concatenate([[True], steps > TOLERANCE])
    closed = np.array([centerline[0], centerline[0] + [2 * TOLERANCE, 0.0]])  # by rounding, in a very short junction
    heights = heights[keep] if keep.sum() > 1 else heights[:2]
    centerline = centerline[keep] if keep.sum() > 1 else closed
    s = arc_lengths(centerline)
    edge = lane.getEdge()
    from_right = edge.getLanes()[::-1] if left_hand else edge.getLanes()
    index = from_right.index(lane)
    beside = {place: other.getID() for place, other in enumerate(from_right) if _drivable(other)}
    following = {
        connection.getViaLaneID() or connection.getToLane().getID(): connection.getState()
        for connection in lane.getOutgoing()
        if _drivable(connection.getToLane())
    }
    inside = lane.getID().startswith(":")
    return Lane(
        id=lane.getID(),
        edge_id=edge.getID(),
        index=index,
        width=float(lane.getWidth()),
        speed_limit=float(lane.getSpeed()),
        centerline=centerline,
        s=s,
        length=float(s[-1]),
        successors=tuple(sorted(following)),
        left=beside.get(index + 1),
        right=beside.get(index - 1),
        is_internal=inside,
        heights=heights if heights.any() else None,
        stops=() if inside else tuple(sorted(name for name, state in following.items() if state in STOP_SIGNS)),
        gives_way=tuple(sorted(name for name, state in following.items() if state and state in GIVES_WAY)),
    )
