"""Routes of agents under control to their goals: a graph search on the lanes, then Bezier curves along them."""

from __future__ import annotations

from functools import cached_property
from heapq import heappop, heappush
from itertools import groupby, pairwise

import numpy as np

from litsim_policy.motion import bezier
from litsim_policy.motion.reference_path import SPACING, ReferencePath, lane_change
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_map import LaneMap

CURVATURE_MAX = VehicleLimits().curvature_max
CHANGE_COST = 20.0  # [m] cost of a lane change, as length of road
CHANGE_LENGTH = 60.0  # [m] most road that a lane change takes
KNOT_SPACING = 15.0  # [m] between the poses on a centre line through which the curves pass
KNOT_MIN = 6.0  # [m] least distance of these, since shorter curves may bend too much
DETOUR = 2.0  # largest ratio of a route's length, less CHANGE_LENGTH, to the straight distance
MERGE_TIME = 2.0  # [s] within which the agent should reach the centre line
BESIDE_SHARES = (1.0, 1.5, 2.5)  # factors on the length of a lane change, tried in this order
MERGE_SHARES = (1.0, 0.5, 1.5, 2.5, 4.0)  # factors on MERGE_TIME, tried in this order


class Router:
    """Finds routes on a lane map.

    The graph's nodes are lanes. A lane is linked to its successors, including lanes inside junctions, at the cost of
    its length, and to its neighbours in the same edge at CHANGE_COST.
    """

    def __init__(self, lane_map: LaneMap) -> None:
        self._lanes = lane_map

    def lanes_between(self, start: int, goal: int) -> list[int] | None:
        """Rows in `LaneMap.lanes` of the shortest route from lane `start` to lane `goal`, both included, or None.

        scipy finds the same by Dijkstra's search (compared for all pairs of lanes of the packaged nets), but takes
        longer to import than all searches of a run.
        """
        cost, before, settled = {start: 0.0}, dict[int, int](), set[int]()
        waiting = [(0.0, start)]
        while waiting:
            so_far, lane = heappop(waiting)
            if lane == goal:
                way = [goal]
                while way[-1] != start:
                    way.append(before[way[-1]])
                return way[::-1]
            if lane in settled:
                continue
            settled.add(lane)
            for other, length in self._links[lane]:
                if so_far + length < cost.get(other, np.inf):
                    cost[other], before[other] = so_far + length, lane
                    heappush(waiting, (cost[other], other))
        return None

    def path(self, pose: FloatArray, speed: float, goal: FloatArray) -> ReferencePath | None:
        """Returns the drivable path from `pose` to `goal`, both (3,) x, y [m], yaw [rad] in frame map, or None.

        It starts at the pose and tangent to it, ends at the goal's position and tangent to the lane there, keeps the
        vehicle's curvature limit, and stays on the road if it starts there. In between it follows the centre lines of
        the lanes of :meth:`lanes_between`, which it reaches within about MERGE_TIME. No goal is off the road.

        Args:
            pose: of the agent.
            speed: of the agent [m/s], for MERGE_TIME.
            goal: the pose to reach; its yaw only selects the lane.
        """
        ends = np.stack([pose, goal])
        on_road, goal_on_road = self._lanes.inside_road(ends[:, 0], ends[:, 1])
        if not goal_on_road:
            return None
        places = self._lanes.nearest(ends[:, 0], ends[:, 1], ends[:, 2])
        way = self.lanes_between(int(places.lane[0]), int(places.lane[1]))
        if way is None or (len(way) == 1 and places.s[1] <= places.s[0]):
            return None
        knots = self._knots(way, float(places.s[0]), float(places.s[1]))
        last = np.array([goal[0], goal[1], places.heading[1]])
        straight = float(np.hypot(*(goal[:2] - pose[:2])))
        if straight < SPACING or _length(knots) > DETOUR * straight + CHANGE_LENGTH:
            return None
        for share in MERGE_SHARES:
            poses = _thinned(pose, knots, last, merge=max(KNOT_MIN, share * max(KNOT_MIN, MERGE_TIME * speed)))
            curves = [bezier.between(a, b) for a, b in pairwise(poses)]
            if max(bezier.curvature_max(curve) for curve in curves) > CURVATURE_MAX:
                continue
            parts = [bezier.points(curve, SPACING) for curve in curves]
            points = np.concatenate([parts[0], *(part[1:] for part in parts[1:])])
            if not on_road or self._lanes.inside_road(points[:, 0], points[:, 1]).all():
                return ReferencePath(points)
        return None

    def beside(self, pose: FloatArray, reach: float, lane: int) -> ReferencePath | None:
        """Returns the drivable path from `pose` (3,) onto the centre line of an adjacent lane and on along it, or None.

        It keeps the vehicle's curvature limit, and stays on the road if it starts there. The change takes
        `reach` [m] of road; longer if it would bend too much or leave the road.
        """
        on_road = bool(self._lanes.inside_road(pose[:1], pose[1:2])[0])
        for share in BESIDE_SHARES:
            curve, beyond = lane_change(self._lanes, pose, self._lanes.lanes[lane], share * reach)
            if bezier.curvature_max(curve) > CURVATURE_MAX:
                continue
            points = bezier.points(curve, SPACING)
            if not on_road or self._lanes.inside_road(points[:, 0], points[:, 1]).all():
                return ReferencePath.through(np.concatenate([points, beyond]))
        return None

    def _knots(self, way: list[int], s_start: float, s_goal: float) -> FloatArray:
        """Poses (k, 3) on the centre lines of the lanes `way`, between arc lengths `s_start` and `s_goal` [m]."""
        lanes, knots = self._lanes.lanes, []
        groups = [list(group) for _, group in groupby(way, key=lambda row: lanes[row].edge_id)]
        for number, group in enumerate(groups):
            begin = s_start if number == 0 else 0.0
            end = s_goal if number == len(groups) - 1 else lanes[group[-1]].length
            if len(group) > 1:
                begin = min(begin + CHANGE_LENGTH, end)
            count = max(1, int(np.ceil((end - begin) / KNOT_SPACING)))
            s = np.linspace(begin, end, count + 1)[1 if number == 0 and len(group) == 1 else 0 :]
            knots.append(np.stack(self._lanes.pose_at(group[-1], s), axis=-1))
        return np.concatenate(knots)

    @cached_property
    def _links(self) -> list[list[tuple[int, float]]]:
        """For each lane, the rows of the lanes to which it is linked, each with its cost [m]."""
        row = self._lanes.row
        return [
            [(row(name), lane.length) for name in lane.successors]
            + [(row(name), CHANGE_COST) for name in (lane.left, lane.right) if name is not None]
            for lane in self._lanes.lanes
        ]


def _thinned(start: FloatArray, knots: FloatArray, last: FloatArray, merge: float) -> FloatArray:
    """`start`, those of `knots` that are at least `merge` [m] from it and not too close to each other, and `last`."""
    poses = [start]
    for knot in knots:
        ahead = (knot[:2] - start[:2]) @ np.array([np.cos(start[2]), np.sin(start[2])])
        free = np.hypot(*(knot[:2] - poses[-1][:2])) >= KNOT_MIN and np.hypot(*(last[:2] - knot[:2])) >= KNOT_MIN
        if free and (len(poses) > 1 or np.hypot(*(knot[:2] - start[:2])) >= merge) and (len(poses) > 1 or ahead > 0):
            poses.append(knot)
    return np.array([*poses, last])


def _length(knots: FloatArray) -> float:
    return float(np.hypot(*np.diff(knots[:, :2], axis=0).T).sum()) if len(knots) > 1 else 0.0
