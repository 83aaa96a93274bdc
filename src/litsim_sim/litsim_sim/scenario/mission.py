"""The mission of the ego: its route over the lanes, and its goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from litsim_sim.core.scene import BoolArray, FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.lane_routes import points_along, shortest_way
from litsim_sim.lane_map.net_lanes import TOLERANCE
from litsim_sim.scenario.checks import way_to_goal
from litsim_sim.scenario.route import edges_of, logged_lanes
from litsim_sim.scenario.scenario import Scenario

HALF_LANE = 1.75  # [m] from the centre line of its lane, up to which a vehicle has not changed lanes
ROUTE_LENGTH = 1000.0  # [m] length of the route


@dataclass(frozen=True)
class Mission:
    """Where the ego is to drive.

    Attributes:
        route: (m, 2) points of the path over the lanes, from where the ego is at step 0 on [m].
        goal: (3,) x, y [m], yaw [rad] of its box centre where it is to arrive.
        on_route: (lanes,) whether the edge of a lane is on the route, or the lane leads from one such edge to another.
        entered: (lanes,) how far along the path it enters each lane [m]; NaN for lanes that it does not use.
    """

    route: FloatArray
    goal: FloatArray
    on_route: BoolArray
    entered: FloatArray

    def waypoints(self, lane_map: LaneMap) -> FloatArray:
        """Returns poses (k, 3) x, y [m], yaw [rad] halfway along each edge between those of the ego and the goal.

        They are on the last lane that the route uses there; junctions have none.
        """
        goal = lane_map.nearest(self.goal[:1], self.goal[1:2], self.goal[2:]).lane[0]
        used = np.argsort(self.entered, kind="stable")[: int(np.isfinite(self.entered).sum())]
        last = {lane_map.lanes[row].edge_id: row for row in used if not lane_map.lanes[row].is_internal}
        between = [*last][1:]
        end = lane_map.lanes[goal].edge_id
        rows = [last[edge] for edge in between[: between.index(end)]] if end in between else []
        poses = [lane_map.pose_at(row, 0.5 * lane_map.lanes[row].length) for row in rows]
        return np.array(poses, np.float64).reshape(-1, 3)


def ego_mission(scenario: Scenario) -> Mission:
    """Returns the mission of the ego: along the edges of its log to its end, or the shortest way to its goal.

    The route begins where the ego is at step 0; if the ego changes lanes in the history, where it is when that is over.
    It goes on straight beyond the goal. Along the log it changes lanes only where its lane does not lead to the end.
    """
    log, lane_map, row = scenario.log, scenario.lane_map, scenario.log.row(scenario.ego_id)
    last, free = int(log.last_step[row]), scenario.history_steps
    poses = np.column_stack([log.x[row], log.y[row], log.yaw[row]])
    history = float(np.hypot(*np.diff(poses[: free + 1, :2], axis=0).T).sum())
    if scenario.file.goal is not None:
        return _to_goal(scenario, poses[free], np.array(scenario.file.goal))
    lanes = logged_lanes(log, lane_map, scenario.ego_id)
    end = lane_map.road_ahead(int(lanes[-1]))[0] if lane_map.lanes[lanes[-1]].is_internal else int(lanes[-1])
    edges = edges_of(lane_map, lanes) | (set() if end is None else {lane_map.lanes[end].edge_id})
    mission = _along(lane_map, poses[0], poses[last], edges, end, history)
    changed = shapely.LineString(mission.route).distance(shapely.Point(poses[free, :2])) > HALF_LANE
    return _along(lane_map, poses[free], poses[last], edges, end, 0.0) if changed else mission


def _to_goal(scenario: Scenario, pose: FloatArray, goal: FloatArray) -> Mission:
    """Returns the mission from `pose` (3,) to `goal` (3,), both x, y [m], yaw [rad]."""
    way, s = way_to_goal(goal, pose, scenario.lane_map, scenario.name)
    return _over(scenario.lane_map, way, s, goal, 0.0)


def _along(
    lane_map: LaneMap, pose: FloatArray, goal: FloatArray, edges: set[str], end: int | None, keep: float
) -> Mission:
    """Returns the mission from `pose` to `goal` along `edges`; lane `end` is where it ends, None beyond the net."""
    place = lane_map.nearest(pose[:1], pose[1:2], pose[2:])
    start, s = int(place.lane[0]), float(place.s[0])
    ahead = lane_map.lanes_from(start, s, ROUTE_LENGTH, edges)
    last = "" if end is None else lane_map.lanes[end].edge_id
    if end is not None and last not in edges_of(lane_map, ahead):
        targets = {row for row, lane in enumerate(lane_map.lanes) if lane.edge_id == last}
        if way := shortest_way(lane_map, start, targets, edges):
            return _over(lane_map, way, s, goal, keep)
    route = lane_map.path_from(start, s, ROUTE_LENGTH, edges)
    return _mission(lane_map, route, goal, ahead, edges, s)


def _over(lane_map: LaneMap, way: list[int], s: float, goal: FloatArray, keep: float) -> Mission:
    """Returns the mission to `goal` over the lanes `way`, by position, from `s` [m] on, and straight on from there."""
    points = points_along(lane_map, way, s, keep)
    left = max(ROUTE_LENGTH - float(np.hypot(*np.diff(points, axis=0).T).sum()), 1.0)
    onward = lane_map.path_from(way[-1], lane_map.lanes[way[-1]].length, left)
    ahead = [*way, *lane_map.lanes_from(way[-1], lane_map.lanes[way[-1]].length, left)[1:]]
    route = np.concatenate([points, onward[1:]])
    apart = np.append(True, np.hypot(*np.diff(route, axis=0).T) > TOLERANCE)  # doubled points would have no direction
    return _mission(lane_map, route[apart], goal, ahead, edges_of(lane_map, way), s)


def _mission(
    lane_map: LaneMap, route: FloatArray, goal: FloatArray, ahead: Sequence[int], edges: set[str], s: float
) -> Mission:
    """Returns the mission over the lanes `ahead`, by position, of which the first is entered at `s` [m]."""
    entered, along = np.full(len(lane_map.lanes), np.nan), 0.0
    for lane, following in zip(ahead, [*ahead[1:], None], strict=True):
        if np.isnan(entered[lane]):
            entered[lane] = along
        here = lane_map.lanes[lane]
        if following is None or lane_map.lanes[following].id in here.successors:
            along += here.length - s
            s = 0.0
    outside = edges | {lane_map.lanes[lane].edge_id for lane in ahead if not lane_map.lanes[lane].is_internal}
    return Mission(route, goal, _on_route(lane_map, outside), entered)


def _on_route(lane_map: LaneMap, edges: set[str]) -> BoolArray:
    """Returns which lanes (lanes,) are of `edges`, or lead within a junction from one of `edges` to another."""
    on_route = np.array([lane.edge_id in edges for lane in lane_map.lanes])
    for row in np.flatnonzero(on_route).tolist():
        inside = [lane_map.row(name) for name in lane_map.lanes[row].successors]
        while inside:
            lane = inside.pop()
            if lane_map.lanes[lane].is_internal and not on_route[lane]:
                on_route[lane] = lane_map.leads_to(lane, edges)
                if on_route[lane]:
                    inside += [lane_map.row(name) for name in lane_map.lanes[lane].successors]
    return on_route
