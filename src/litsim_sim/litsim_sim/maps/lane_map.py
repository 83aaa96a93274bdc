"""Lane queries on a SUMO net: where is a pose on the road, and where does the road lead.

Everything is in frame map: metres of the net, x right, y up, headings in radians counter-clockwise from +x. Along a
lane, `s` is the arc length of its centre line from its start and `d` the distance to the left of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast
from xml.sax import SAXException

import numpy as np
import sumolib

from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import box_corners, wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray

DIRECTION_PENALTY = 4.0  # [m] times 1 - cos of the angle between a pose and a lane: opposite lanes are 8 m further
INTERNAL_PENALTY = 1.0  # [m] by which a lane inside a junction must be nearer to win
CELL = 16.0  # [m] of the lookup grid
REACH = 12.0  # [m] around a cell within which its candidates are complete; farther poses search the whole net
TOLERANCE = 1e-3  # [m] coordinates of a net are rounded to this


@dataclass(frozen=True)
class Lane:
    """One lane.

    Attributes:
        id, edge_id: SUMO's names.
        index: position in its edge, 0 is the rightmost.
        width: [m].
        speed_limit: [m/s].
        centerline: (k, 2) in driving direction [m].
        s: (k,) arc length of the vertices, from 0 [m].
        length: [m].
        successors: ids of the lanes that follow directly; where a junction has internal lanes, those.
        left, right: ids of the neighbours in the same edge, None at its borders.
        is_internal: inside a junction.
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


@dataclass(frozen=True)
class LanePosition:
    """Poses relative to their lanes; arrays of shape (n,).

    Attributes:
        lane: position in `LaneMap.lanes`.
        s: along the lane's centre line, within [0, length] [m].
        d: to the left of it [m].
        heading: of the centre line there [rad].
    """

    lane: IntArray
    s: FloatArray
    d: FloatArray
    heading: FloatArray


class LaneMap:
    """Lanes and vectorised queries on them.

    Attributes:
        lanes: in the order of their ids.
        bounds: (x min, y min, x max, y max) of all centre lines [m].
    """

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.lanes: tuple[Lane, ...] = tuple(sorted(lanes, key=lambda lane: lane.id))
        self._row = {lane.id: row for row, lane in enumerate(self.lanes)}
        counts = [len(lane.s) - 1 for lane in self.lanes]
        self._first_segment = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._segment_lane = np.repeat(np.arange(len(self.lanes)), counts)
        starts = np.concatenate([lane.centerline[:-1] for lane in self.lanes])
        step = np.concatenate([np.diff(lane.centerline, axis=0) for lane in self.lanes])
        size = np.hypot(step[:, 0], step[:, 1])
        self._start_x, self._start_y, self._size = starts[:, 0], starts[:, 1], size
        self._cos, self._sin = step[:, 0] / size, step[:, 1] / size
        self._heading = np.arctan2(step[:, 1], step[:, 0])
        self._start_s = np.concatenate([lane.s[:-1] for lane in self.lanes])
        self._length = np.array([lane.length for lane in self.lanes])
        # One ascending key for all lanes, so that one search finds the segment of any (lane, s).
        self._lane_key = np.concatenate([[0.0], np.cumsum(self._length + 1.0)])
        self._start_key = self._lane_key[self._segment_lane] + self._start_s
        self._half_width = 0.5 * np.array([lane.width for lane in self.lanes])[self._segment_lane]
        internal = np.array([lane.is_internal for lane in self.lanes])[self._segment_lane]
        self._penalty = np.where(internal, INTERNAL_PENALTY, 0.0)
        points = np.concatenate([lane.centerline for lane in self.lanes])
        (x_min, y_min), (x_max, y_max) = points.min(axis=0) + 0.0, points.max(axis=0) + 0.0  # no -0
        self.bounds: tuple[float, float, float, float] = (float(x_min), float(y_min), float(x_max), float(y_max))
        self._straightest = [self._straightest_successor(lane) for lane in self.lanes]
        self._near = self._neighbourhoods()
        self._grid, self._grid_shape = self._make_grid()

    @classmethod
    def from_net(cls, path: Path) -> LaneMap:
        """Read a SUMO net.

        Raises:
            InputError: the file is missing, is no SUMO net, or holds no lanes.
        """
        if not path.is_file():
            raise InputError(f"{path}: no such net")
        try:
            net: Any = sumolib.net.readNet(str(path), withInternal=True, lxml=False)
            edges = net.getEdges(withInternal=True)
            lanes = [_lane(lane) for edge in edges for lane in edge.getLanes() if _drivable(lane)]
        except (SAXException, OSError, KeyError, ValueError, AttributeError, TypeError, IndexError) as error:
            raise InputError(f"{path}: not a readable SUMO net: {error!r}") from error
        if not lanes:
            raise InputError(f"{path}: the net holds no lanes")
        known = {lane.id for lane in lanes}
        for lane in lanes:
            lost = [name for name in lane.successors if name not in known]
            if lost:
                raise InputError(f"{path}: lane {lane.id} leads to unknown lanes {lost}")
        return cls(lanes)

    def row(self, lane_id: str) -> int:
        """Position in `lanes` of the lane named `lane_id`; KeyError where there is none."""
        return self._row[lane_id]

    def nearest(self, x: FloatArray, y: FloatArray, yaw: FloatArray | None = None) -> LanePosition:
        """The lane that each pose is on or nearest to.

        Distance decides, with handicaps for lanes inside junctions and, where `yaw` is given, for lanes that lead
        elsewhere. Equal lanes are decided by id.

        Args:
            x, y: (n,) [m].
            yaw: (n,) headings [rad].
        """
        x, y = np.atleast_1d(np.asarray(x, np.float64)), np.atleast_1d(np.asarray(y, np.float64))
        yaw = None if yaw is None else np.atleast_1d(np.asarray(yaw, np.float64))
        segments = self._candidates(x, y)
        cost = self._cost(x, y, yaw, segments)
        best = np.argmin(cost, axis=1)
        rows = np.arange(len(x))
        segment = segments[rows, best]
        far = np.flatnonzero(~(cost[rows, best] <= REACH))
        if len(far):
            every = np.broadcast_to(np.arange(len(self._size)), (len(far), len(self._size)))
            cost = self._cost(x[far], y[far], None if yaw is None else yaw[far], every)
            segment[far] = np.argmin(cost, axis=1)
        along, d = self._project(x, y, segment)
        s = self._start_s[segment] + np.clip(along, 0.0, self._size[segment])
        return LanePosition(self._segment_lane[segment], s, d, self._heading[segment])

    def pose_at(self, lane: int | IntArray, s: float | FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y [m] and heading [rad] at arc length(s) `s` of the lane(s) at position(s) `lane`; shapes broadcast.

        Beyond its ends a lane is continued straight.
        """
        lane, s = np.asarray(lane, np.int64), np.asarray(s, np.float64)
        within = np.clip(s, 0.0, self._length[lane])
        segment = np.searchsorted(self._start_key, self._lane_key[lane] + within, side="right") - 1
        segment = np.clip(segment, self._first_segment[lane], self._first_segment[lane + 1] - 1)
        along = s - self._start_s[segment]
        x = self._start_x[segment] + along * self._cos[segment]
        y = self._start_y[segment] + along * self._sin[segment]
        return x, y, self._heading[segment]

    def path_from(self, lane_index: int, s: float, length: float) -> FloatArray:
        """The centre line from `s` on the lane at position `lane_index` for `length` metres, as points (m, 2).

        Of several successors the straightest is taken (of equally straight ones the first by id). Where the net ends,
        the path goes straight on, so that a vehicle that follows it leaves the net.
        """
        lane, left, at = lane_index, length, min(max(s, 0.0), self.lanes[lane_index].length)
        points = [np.stack(self.pose_at(lane, at)[:2], axis=-1)[None]]
        while True:
            here = self.lanes[lane]
            ahead = here.length - at
            if ahead >= left:
                inner = (here.s > at) & (here.s < at + left)
                end = np.stack(self.pose_at(lane, at + left)[:2], axis=-1)[None]
                points += [here.centerline[inner], end]
                break
            points.append(here.centerline[here.s > at])
            left -= ahead
            following = self._straightest[lane]
            if following is None:
                beyond = np.stack(self.pose_at(lane, here.length + left)[:2], axis=-1)[None]
                points.append(beyond)
                break
            lane, at = following, 0.0
        path = np.concatenate(points)
        # Lanes meet within the rounding of the net: doubled points would have no direction.
        keep = np.concatenate([[True], np.hypot(*np.diff(path, axis=0).T) > TOLERANCE])
        return cast(FloatArray, path[keep])

    def inside_road(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """(n,) whether points lie within half a lane width of some lane's centre line."""
        x, y = np.atleast_1d(np.asarray(x, np.float64)), np.atleast_1d(np.asarray(y, np.float64))
        segments = self._candidates(x, y)
        distance = self._distance(x[:, None], y[:, None], segments)
        return cast(BoolArray, ((distance <= self._half_width[segments] + TOLERANCE) & (segments >= 0)).any(axis=1))

    def inside_lane(
        self, x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray
    ) -> BoolArray:
        """(n,) whether boxes (centre [m], heading [rad], extents [m]) lie wholly within one lane.

        The lane is that of the box centre, together with the lanes that precede and follow it directly.
        """
        at = self.nearest(x, y, yaw)
        corners = box_corners(x, y, yaw, length, width)
        corner_x, corner_y = corners[..., 0].ravel(), corners[..., 1].ravel()
        segments = self._candidates(corner_x, corner_y)
        same = self._near[np.repeat(at.lane, 4)[:, None], self._segment_lane[segments]] & (segments >= 0)
        distance = self._distance(corner_x[:, None], corner_y[:, None], segments)
        inside = ((distance <= self._half_width[segments] + TOLERANCE) & same).any(axis=1)
        return cast(BoolArray, inside.reshape(-1, 4).all(axis=1))

    def _cost(self, x: FloatArray, y: FloatArray, yaw: FloatArray | None, segments: IntArray) -> FloatArray:
        """(n, k) distance plus handicaps of candidate `segments` (n, k); infinite where a candidate is -1."""
        cost = self._distance(x[:, None], y[:, None], segments) + self._penalty[segments]
        if yaw is not None:
            facing = np.cos(yaw)[:, None] * self._cos[segments] + np.sin(yaw)[:, None] * self._sin[segments]
            cost += DIRECTION_PENALTY * (1.0 - facing)
        return np.where(segments >= 0, cost, np.inf)

    def _project(self, x: FloatArray, y: FloatArray, segment: IntArray) -> tuple[FloatArray, FloatArray]:
        """Along and left of segments, from their starts [m]; shapes broadcast."""
        dx, dy = x - self._start_x[segment], y - self._start_y[segment]
        cos, sin = self._cos[segment], self._sin[segment]
        return dx * cos + dy * sin, dy * cos - dx * sin

    def _distance(self, x: FloatArray, y: FloatArray, segment: IntArray) -> FloatArray:
        """Distance of points to segments [m]; shapes broadcast."""
        along, d = self._project(x, y, segment)
        over = np.maximum(np.maximum(-along, along - self._size[segment]), 0.0)
        return cast(FloatArray, np.hypot(over, d))

    def _candidates(self, x: FloatArray, y: FloatArray) -> IntArray:
        """(n, k) segments that can be within REACH of each point, padded with -1; all -1 off the grid."""
        columns, rows = self._grid_shape
        column = np.floor((x - self.bounds[0] + REACH) / CELL)
        row = np.floor((y - self.bounds[1] + REACH) / CELL)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cell = np.where(inside, row * columns + column, columns * rows).astype(np.int64)
        return self._grid[cell]

    def _make_grid(self) -> tuple[IntArray, tuple[int, int]]:
        """Candidates (cells + 1, k) by cell; the last row serves all points outside of the grid."""
        x_min, y_min, x_max, y_max = self.bounds
        columns = int((x_max - x_min + 2 * REACH) // CELL) + 1
        rows = int((y_max - y_min + 2 * REACH) // CELL) + 1
        lists: list[list[int]] = [[] for _ in range(columns * rows + 1)]
        for segment in range(len(self._size)):
            # A cell's candidates are complete for its own points: centre of the cell, half its diagonal, and REACH.
            margin = REACH + CELL
            ends_x = self._start_x[segment] + np.array([0.0, self._size[segment] * self._cos[segment]])
            ends_y = self._start_y[segment] + np.array([0.0, self._size[segment] * self._sin[segment]])
            from_column = max(int((ends_x.min() - margin - x_min + REACH) // CELL), 0)
            to_column = min(int((ends_x.max() + margin - x_min + REACH) // CELL), columns - 1)
            from_row = max(int((ends_y.min() - margin - y_min + REACH) // CELL), 0)
            to_row = min(int((ends_y.max() + margin - y_min + REACH) // CELL), rows - 1)
            column, row = np.meshgrid(np.arange(from_column, to_column + 1), np.arange(from_row, to_row + 1))
            centre_x = x_min - REACH + (column.astype(np.float64) + 0.5) * CELL
            centre_y = y_min - REACH + (row.astype(np.float64) + 0.5) * CELL
            near = self._distance(centre_x, centre_y, np.array(segment)) <= REACH + CELL * np.sqrt(0.5)
            for cell in (row * columns + column)[near]:
                lists[cell].append(segment)
        grid = np.full((len(lists), max(len(entry) for entry in lists)), -1, np.int64)
        for cell, entry in enumerate(lists):
            grid[cell, : len(entry)] = entry
        return grid, (columns, rows)

    def _neighbourhoods(self) -> BoolArray:
        """(lanes, lanes) whether the second is the first itself, or directly precedes or follows it."""
        near = np.eye(len(self.lanes), dtype=np.bool_)
        for row, lane in enumerate(self.lanes):
            for name in lane.successors:
                near[row, self._row[name]] = near[self._row[name], row] = True
        return near

    def _straightest_successor(self, lane: Lane) -> int | None:
        """Position of the successor that turns least, None where the net ends."""
        if not lane.successors:
            return None

        def turn(name: str) -> tuple[float, str]:
            start = self._first_segment[self._row[name]]
            end = self._first_segment[self._row[lane.id] + 1] - 1
            # The net's rounding must not decide between lanes that go on in the same direction.
            return round(abs(float(wrap_angle(self._heading[start] - self._heading[end]))), 3), name

        return self._row[min(lane.successors, key=turn)]


def _drivable(lane: Any) -> bool:
    """Whether cars may use a lane: no footpaths, crossings or rails."""
    return bool(lane.allows("passenger"))


def _lane(lane: Any) -> Lane:
    """A lane as sumolib has read it."""
    centerline = np.array([point[:2] for point in lane.getShape()], np.float64)
    steps = np.hypot(*np.diff(centerline, axis=0).T)
    keep = np.concatenate([[True], steps > TOLERANCE])
    closed = np.array([centerline[0], centerline[0] + [2 * TOLERANCE, 0.0]])  # by rounding, in a very short junction
    centerline = centerline[keep] if keep.sum() > 1 else closed
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(centerline, axis=0).T))])
    edge, index = lane.getEdge(), int(lane.getIndex())
    beside = {int(other.getIndex()): other.getID() for other in edge.getLanes() if _drivable(other)}
    following = []
    for connection in lane.getOutgoing():
        name = connection.getViaLaneID() or connection.getToLane().getID()
        if connection.getToLane().allows("passenger"):
            following.append(name)
    return Lane(
        id=lane.getID(),
        edge_id=edge.getID(),
        index=index,
        width=float(lane.getWidth()),
        speed_limit=float(lane.getSpeed()),
        centerline=centerline,
        s=s,
        length=float(s[-1]),
        successors=tuple(sorted(set(following))),
        left=beside.get(index + 1),
        right=beside.get(index - 1),
        is_internal=lane.getID().startswith(":"),
    )
