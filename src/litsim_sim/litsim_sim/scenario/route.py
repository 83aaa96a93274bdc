"""Routes: the lanes from a pose on, along the edges that the log of an agent takes, and the route of the ego."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import shapely

from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

HALF_LANE = 1.75  # [m] from the centre line of its lane, up to which a vehicle has not changed lanes


def logged_edges(log: Log, lane_map: LaneMap, agent: int) -> set[str]:
    """Returns the edges that the log of `agent` takes."""
    return _edges(lane_map, _logged_lanes(log, lane_map, agent))


def lanes_ahead(lane_map: LaneMap, pose: FloatArray, length: float, edges: Collection[str]) -> FloatArray:
    """Returns points (m, 2) of the centre line of the lane at `pose` (3,) x, y [m], yaw [rad], along `edges`.

    They reach `length` [m] from the pose on. They never change lanes; where the lane leaves the edges, and beyond
    these, they go straight on.
    """
    place = lane_map.nearest(pose[:1], pose[1:2], pose[2:])
    return lane_map.path_from(int(place.lane[0]), float(place.s[0]), length, edges)


def ego_route(scenario: Scenario, length: float) -> FloatArray:
    """Returns points (m, 2) of the route of the ego, `length` [m] along the edges of its log, see :func:`lanes_ahead`.

    It begins where the ego is at step 0; if the ego changes lanes in the history, where it is when that is over.
    """
    log, lane_map, row = scenario.log, scenario.lane_map, scenario.log.row(scenario.ego_id)
    lanes = _logged_lanes(log, lane_map, scenario.ego_id)
    end = lane_map.road_ahead(int(lanes[-1]))[0]  # of a log within a junction
    edges = _edges(lane_map, lanes) | (set() if end is None else {lane_map.lanes[end].edge_id})
    poses = np.column_stack([log.x[row], log.y[row], log.yaw[row]])[[0, scenario.history_steps]]
    route = lanes_ahead(lane_map, poses[0], length, edges)
    changed = shapely.LineString(route).distance(shapely.Point(poses[1, :2])) > HALF_LANE
    return lanes_ahead(lane_map, poses[1], length, edges) if changed else route


def _edges(lane_map: LaneMap, lanes: IntArray) -> set[str]:
    """Returns the edges of the lanes at the positions `lanes` (m,)."""
    return {lane_map.lanes[lane].edge_id for lane in np.unique(lanes)}


def _logged_lanes(log: Log, lane_map: LaneMap, agent: int) -> IntArray:
    """Returns the positions (m,) of the lanes that `agent` is nearest to at each step of its log."""
    row = int(np.searchsorted(log.ids, agent))
    valid = log.valid[row]
    return lane_map.nearest(log.x[row][valid], log.y[row][valid], log.yaw[row][valid]).lane
