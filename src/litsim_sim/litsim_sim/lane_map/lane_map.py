"""Lane queries on a SUMO net: positions of poses on lanes, and paths along lanes.

Everything is in frame map: metres of the net, x right, y up, headings in radians counter-clockwise from +x. Along a
lane, `s` is the arc length of its centre line from its start and `d` the distance to the left of it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from litsim_sim.core.geometry import box_corners
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, Ints
from litsim_sim.lane_map.lane_graph import directly_linked, legal_limits, straightest_successors
from litsim_sim.lane_map.net_ends import NetEnds
from litsim_sim.lane_map.net_lanes import LEVEL, TOLERANCE, Lane, read_lanes
from litsim_sim.lane_map.segment_grid import (
    any_within,
    distance,
    grid_over,
    nearest_segments,
    poses_along,
    segments_at,
    segments_of,
)

if TYPE_CHECKING:
    from litsim_sim.lane_map.levels import Levels

DIRECTION_PENALTY = 4.0  # [m] times 1 - cos of the angle between a pose and a lane: opposite lanes are 8 m further
INTERNAL_PENALTY = 1.0  # [m] by which a lane inside a junction must be nearer to win


class LanePosition(NamedTuple):
    """Poses relative to their lanes; arrays of shape (n,).

    Attributes:
        lane: position in `LaneMap.lanes`.
        s: along the lane's centre line, within [0, length] [m].
        d: to the left of it [m].
        heading: heading of the centre line there [rad].
    """

    lane: Ints
    s: Floats
    d: Floats
    heading: Floats

    def take(self, rows: IntArray) -> LanePosition:
        """Returns the positions of the poses in `rows` (m,)."""
        return LanePosition(self.lane[rows], self.s[rows], self.d[rows], self.heading[rows])

    def against(self, yaw: FloatArray) -> BoolArray:
        """Returns whether headings `yaw` (n,) [rad] are opposite to the lanes (n,)."""
        return np.cos(self.heading - yaw) < 0.0


class LaneMap:
    """Lanes and vectorised queries on them.

    Attributes:
        lanes: in the order of their ids.
        bounds: (x min, y min, x max, y max) of all centre lines [m].
    """

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.lanes: tuple[Lane, ...] = tuple(sorted(lanes, key=lambda lane: lane.id))
        self._row = {lane.id: row for row, lane in enumerate(self.lanes)}
        points = np.concatenate([lane.centerline for lane in self.lanes])
        (x_min, y_min), (x_max, y_max) = points.min(axis=0) + 0.0, points.max(axis=0) + 0.0  # no -0
        self.bounds: tuple[float, float, float, float] = (float(x_min), float(y_min), float(x_max), float(y_max))
        self._segments = segments_of(self.lanes)
        self._grid = grid_over(self.bounds, self._segments)
        self._lane = np.repeat(np.arange(len(self.lanes)), np.diff(self._segments.first))  # of each segment
        self._reach = 0.5 * self.widths[self._lane] + TOLERANCE
        self._penalty = np.where(self.internal[self._lane], INTERNAL_PENALTY, 0.0)
        self._straightest = straightest_successors(self.lanes)
        self._straightest_rows = np.array([-1 if row is None else row for row in self._straightest], np.int64)
        self._near = directly_linked(self.lanes)

    @cached_property
    def ends(self) -> NetEnds:
        """Where roads lead out of the net."""
        return NetEnds(self.lanes)

    @cached_property
    def levels(self) -> Levels | None:
        """Roads that pass over others; None for a net that is too flat for them."""
        heights = [lane.heights if lane.heights is not None else np.zeros(1) for lane in self.lanes]
        if np.ptp(np.concatenate(heights)) < LEVEL:
            return None
        from litsim_sim.lane_map.levels import Levels  # imported here: it needs scipy, and most nets are flat

        return Levels(self.lanes)

    @cached_property
    def widths(self) -> FloatArray:
        """(lanes,) widths [m]."""
        return np.array([lane.width for lane in self.lanes])

    @cached_property
    def internal(self) -> BoolArray:
        """(lanes,) whether a lane is inside a junction."""
        return np.array([lane.is_internal for lane in self.lanes])

    @cached_property
    def speed_limits(self) -> FloatArray:
        """(lanes,) speed limits [m/s]; within junctions the higher one of the lanes before and after (nuPlan)."""
        return legal_limits(self.lanes)

    @classmethod
    def from_net(cls, path: Path) -> LaneMap:
        """Read a SUMO net; raises InputError if the file is missing, is no SUMO net, or holds no lanes."""
        return cls(read_lanes(path))

    def row(self, lane_id: str) -> int:
        """Returns the position in `lanes` of the lane named `lane_id`; raises KeyError if there is none."""
        return self._row[lane_id]

    def nearest(self, x: FloatArray, y: FloatArray, yaw: FloatArray | None = None) -> LanePosition:
        """Finds the lane that each pose, of `x`, `y` [m] and `yaw` [rad] (n,), is on or nearest to.

        Distance decides, with handicaps for lanes inside junctions and, where `yaw` is given, for lanes that
        lead elsewhere. Equal lanes are decided by id.
        """
        x, y = _column(x), _column(y)
        # without a heading, all directions are alike
        turn, heading = (0.0, np.zeros(len(x))) if yaw is None else (DIRECTION_PENALTY, _column(yaw))
        cos, sin, of = np.cos(heading), np.sin(heading), self._segments
        segment, (s, d) = nearest_segments(x, y, cos, sin, turn, self._grid, self._penalty, of)
        return LanePosition(self._lane[segment], s, d, of.heading[segment])

    def pose_at(self, lane: int | IntArray, s: float | FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y [m] and heading [rad] at arc length(s) `s` of the lane(s) at position(s) `lane`; shapes broadcast.

        Beyond its ends a lane is continued straight.
        """
        lane, s = np.asarray(lane, np.int64), np.asarray(s, np.float64)
        if lane.shape != s.shape:
            lane, s = np.broadcast_arrays(lane, s)
        lanes, lengths, of = np.ascontiguousarray(lane).reshape(-1), np.ascontiguousarray(s).reshape(-1), self._segments
        segment = segments_at(lanes, lengths, of).reshape(s.shape)
        along = s - of.start_s[segment]
        x, y = of.start_x[segment] + along * of.cos[segment], of.start_y[segment] + along * of.sin[segment]
        return x, y, of.heading[segment]

    def headings_around(self, lane: IntArray, s: FloatArray, reach: float) -> FloatArray:
        """Returns headings (n, 2) [rad] `reach` [m] before and beyond arc lengths `s` (n,) [m] of lanes `lane` (n,)."""
        return np.column_stack([self.pose_at(lane, place)[2] for place in (s - reach, s + reach)])

    def poses_along(self, lane: IntArray, s: FloatArray, steps: int, step: float = 1.0) -> FloatArray:
        """Returns poses (n, steps, 3) x, y [m], yaw [rad] on centre lines, from arc lengths `s` of lanes `lane` on.

        They are `step` [m] apart, and go on as :meth:`path_from` without a route: straightest, and straight on
        where the net ends.
        """
        lanes, lengths = np.ascontiguousarray(lane), np.ascontiguousarray(s)
        return poses_along(lanes, lengths, self._straightest_rows, steps, step, self._segments)

    def path_from(self, lane_index: int, s: float, length: float, route: Collection[str] = ()) -> FloatArray:
        """Returns the centre line from `s` on the lane at position `lane_index` for `length` metres, as points (m, 2).

        Of several successors one is taken that leads to an edge of `route`, and of those, or where there is none, the
        straightest (of equally straight ones the first by id). Where the net ends, the path goes straight on, so that a
        vehicle that follows it leaves the net.
        """
        lane, left, place = lane_index, length, min(max(s, 0.0), self.lanes[lane_index].length)
        points = [np.stack(self.pose_at(lane, place)[:2], axis=-1)[None]]
        while True:
            here = self.lanes[lane]
            ahead = here.length - place
            if ahead >= left:
                inner = (here.s > place) & (here.s < place + left)
                end = np.stack(self.pose_at(lane, place + left)[:2], axis=-1)[None]
                points += [here.centerline[inner], end]
                break
            points.append(here.centerline[here.s > place])
            left -= ahead
            following = self._following(lane, route)
            if following is None:
                points.append(np.stack(self.pose_at(lane, here.length + left)[:2], axis=-1)[None])
                break
            lane, place = following, 0.0
        path = np.concatenate(points)
        # Lanes meet within the rounding of the net: doubled points would have no direction.
        keep = np.concatenate([[True], np.hypot(*np.diff(path, axis=0).T) > TOLERANCE])
        return cast(FloatArray, path[keep])

    def lanes_from(self, lane_index: int, s: float, length: float, route: Collection[str] = ()) -> list[int]:
        """Returns the positions of the lanes that :meth:`path_from` takes, in order."""
        lanes, left = [lane_index], length - (self.lanes[lane_index].length - s)
        while left > 0.0 and (following := self._following(lanes[-1], route)) is not None:
            lanes.append(following)
            left -= self.lanes[following].length
        return lanes

    def _following(self, lane: int, route: Collection[str]) -> int | None:
        """Returns the successor of a lane, both by position, that a path along the edges `route` takes."""
        straightest = self._straightest[lane]
        successors = [] if straightest is None else [self._row[name] for name in self.lanes[lane].successors]
        return next((row for row in (straightest, *successors) if self.leads_to(row, route)), straightest)

    def leads_to(self, lane: int | None, edges: Collection[str]) -> bool:
        """Returns whether the first edge outside junctions from the lane at position `lane` on is one of `edges`."""
        if lane is not None and self.lanes[lane].is_internal:
            lane, _ = self.road_ahead(lane)
        return lane is not None and self.lanes[lane].edge_id in edges

    def road_ahead(self, lane: int) -> tuple[int | None, float]:
        """Follows the straightest successors from the lane at position `lane` to the next lane outside junctions.

        Returns:
            position of that lane, None where the net ends before one; length of the lanes inside junctions between [m].
        """
        following, length = self._straightest[lane], 0.0
        while following is not None and self.lanes[following].is_internal:
            length += self.lanes[following].length
            following = self._straightest[following]
        return following, length

    def inside_road(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Returns whether points (n,) lie within half a lane width of some lane's centre line (n,)."""
        return any_within(_column(x), _column(y), self._grid, self._segments, self._reach)

    def against(self, x: FloatArray, y: FloatArray, yaw: FloatArray) -> BoolArray:
        """Returns whether poses (n,) head the other way than all lanes there (n,)."""
        return self.nearest(x, y, yaw).against(_column(yaw))

    def inside_lane(
        self, x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray
    ) -> BoolArray:
        """Returns whether boxes (centre [m], heading [rad], extents [m]) lie wholly within one lane (n,).

        The lane is that of the box centre, together with the lanes that precede and follow it directly.
        """
        place = self.nearest(x, y, yaw)
        corners = box_corners(x, y, yaw, length, width)
        corner_x, corner_y = corners[..., 0].ravel(), corners[..., 1].ravel()
        same = self._near[np.repeat(place.lane, 4)[:, None], self._lane]
        away = distance(corner_x[:, None], corner_y[:, None], self._segments, np.arange(len(self._reach)))
        inside = ((away <= self._reach) & same).any(axis=1)
        return cast(BoolArray, inside.reshape(-1, 4).all(axis=1))


def _column(values: FloatArray) -> FloatArray:
    """Returns `values`, one number or an array (n,), as a C-ordered array (n,) of float64."""
    return np.ascontiguousarray(values, np.float64).reshape(-1)
