"""Ends of a net: the ends of the roads that lead out of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.lane_map.net_lanes import Lane

BEYOND_MAX = 10.0  # [m] past an end: a vehicle that has just left by it is no farther, two steps at any speed
SIDE_ROOM = 3.5  # [m] beyond the edge of a lane: a vehicle that leaves by its end is no farther to the side
GOES_ON = 6.0  # [m] a vehicle this near a lane that goes on in the same direction has not left: its own was dropped
SAME_DIRECTION = np.deg2rad(60.0)


class NetEnds:
    """The ends of the lanes of edges that lead nowhere."""

    def __init__(self, lanes: Sequence[Lane]) -> None:
        goes_on = {lane.edge_id for lane in lanes if lane.successors}
        self._ends = [lane for lane in lanes if lane.edge_id not in goes_on and not lane.is_internal]
        self._names = {lane.id for lane in self._ends}
        self._lanes = tuple(lanes)
        lines = [lane.centerline for lane in self._ends]
        self._x, self._y = (np.array([line[-1, axis] for line in lines]) for axis in (0, 1))
        self._heading = np.array([lane.headings[1] for lane in self._ends])
        self._reach = np.array([0.5 * lane.width + SIDE_ROOM for lane in self._ends])

    def passed(self, x: float, y: float) -> str | None:
        """Returns the id of the lane by whose end a vehicle at (x, y) [m], on no lane, has left the net; else None."""
        ahead, left = to_body(x - self._x, y - self._y, self._heading)
        near = (ahead > 0.0) & (ahead <= BEYOND_MAX) & (np.abs(left) <= self._reach)
        for k in np.flatnonzero(near)[np.argsort(np.abs(left[near]), kind="stable")]:
            if not self._goes_on(x, y, float(self._heading[k])):
                return self._ends[k].id
        return None

    def _goes_on(self, x: float, y: float, heading: float) -> bool:
        """Returns whether a road continues beside (x, y) [m] in the direction `heading` [rad]."""
        point = shapely.Point(x, y)
        for lane in self._lanes:
            line = shapely.LineString(lane.centerline)
            ends_here = lane.id in self._names and line.project(point) > lane.length - BEYOND_MAX
            if not ends_here and line.distance(point) <= GOES_ON:
                vertex = min(int(np.searchsorted(lane.s, line.project(point), side="right")), len(lane.s) - 1)
                dx, dy = lane.centerline[vertex] - lane.centerline[vertex - 1]
                if abs(wrap_angle(np.arctan2(dy, dx) - heading)) <= SAME_DIRECTION:
                    return True
        return False
