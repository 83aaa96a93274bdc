"""Routes: the lanes from a pose on, along the edges that the log of an agent takes."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log


def logged_edges(log: Log, lane_map: LaneMap, agent: int) -> set[str]:
    """Returns the edges that the log of `agent` takes."""
    return edges_of(lane_map, logged_lanes(log, lane_map, agent))


def lanes_ahead(lane_map: LaneMap, pose: FloatArray, length: float, edges: Collection[str]) -> FloatArray:
    """Returns points (m, 2) of the centre line of the lane at `pose` (3,) x, y [m], yaw [rad], along `edges`.

    They reach `length` [m] from the pose on. They never change lanes; where the lane leaves the edges, and beyond
    these, they go straight on.
    """
    place = lane_map.nearest(pose[:1], pose[1:2], pose[2:])
    return lane_map.path_from(int(place.lane[0]), float(place.s[0]), length, edges)


def edges_of(lane_map: LaneMap, lanes: IntArray | Sequence[int]) -> set[str]:
    """Returns the edges of the lanes at the positions `lanes` (m,)."""
    return {lane_map.lanes[lane].edge_id for lane in np.unique(lanes)}


def logged_lanes(log: Log, lane_map: LaneMap, agent: int) -> IntArray:
    """Returns the positions (m,) of the lanes that `agent` is nearest to at each step of its log."""
    row = int(np.searchsorted(log.ids, agent))
    valid = log.valid[row]
    return lane_map.nearest(log.x[row][valid], log.y[row][valid], log.yaw[row][valid]).lane
