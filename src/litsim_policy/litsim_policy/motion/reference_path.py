"""Reference paths: polylines in frame map that vehicles follow, positions along them, and their pursuit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from litsim_policy.motion import bezier
from litsim_policy.motion.path_batch import PathBatch, thinned
from litsim_sim.core.geometry import arc_lengths
from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.route import lanes_ahead, logged_edges

SPACING = 1.0  # [m] between points; recorded positions jitter at shorter distances
LANE_LENGTH = 2000.0  # [m] length of a path along a lane: more than any run covers
CHANGE_MIN = 10.0  # [m] least length of a lane change, also of a standing vehicle
BEYOND = 300.0  # [m] length of a logged path along its lane beyond the end of the log


@dataclass(frozen=True)
class ReferencePath:
    """A polyline with its arc length.

    Attributes:
        points: (m, 2) in frame map [m], m >= 2, no two neighbours equal.
    """

    points: FloatArray

    @classmethod
    def through(cls, points: FloatArray) -> ReferencePath:
        """Returns path through `points` (m, 2); points closer than half the spacing to their predecessor are dropped.

        Raises:
            ValueError: fewer than two points are left.
        """
        rows = thinned(points, 0.5 * SPACING)
        if len(rows) < 2:
            raise ValueError("a path needs two points that differ")
        return cls(points[rows])

    @cached_property
    def s(self) -> FloatArray:
        """Arc length (m,) of each point from the first [m]."""
        return arc_lengths(self.points)

    def project(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the arc length s (n,) and offset d (n,), positive to the left, of the nearest point of the path [m].

        The first and last segments are prolonged, so points before or beyond the path have s < 0 or s > length.
        """
        foot = self.batch.project(np.zeros(len(x), np.int64), x, y)
        return foot.s, foot.d

    def point(self, s: float) -> FloatArray:
        """Returns point (2,) at arc length `s` [m], with ends prolonged."""
        return self.batch.point(np.array([s]))[0]

    def heading(self, s: FloatArray) -> FloatArray:
        """Returns directions (n,) [rad] of the path at arc lengths `s` (n,) [m]."""
        return self.batch.heading(0, self.batch.segment(s, np.zeros(len(s), np.int64)))

    def followed_by(self, other: ReferencePath) -> ReferencePath:
        """Returns this path, continued from its end along `other`."""
        s, _ = other.project(self.points[-1:, 0], self.points[-1:, 1])
        return ReferencePath(np.concatenate([self.points, other.points[other.s > s[0] + 0.5 * SPACING]]))

    @cached_property
    def batch(self) -> PathBatch:
        """This path alone, as a batch of one."""
        return PathBatch.of([self.points])


def logged_path(log: Log, lane_map: LaneMap, agent: int) -> ReferencePath:
    """Returns the recorded path of `agent`, continued along its last lane; cached for all runs of a log."""
    own, recorded = log.recorded(agent)
    made_of = id(lane_map), recorded
    if made_of not in own.paths:
        own.paths[made_of] = lane_map, _logged_path(own, lane_map, recorded)  # kept, so that its id stays valid
    path: ReferencePath = own.paths[made_of][1]
    return path


def _logged_path(log: Log, lane_map: LaneMap, agent: int) -> ReferencePath:
    """See :func:`logged_path`."""
    row = int(np.searchsorted(log.ids, agent))
    valid = log.valid[row]
    points = np.column_stack([log.x[row][valid], log.y[row][valid]])
    travelled = arc_lengths(points)
    marks = np.arange(0.0, travelled[-1], SPACING)
    steps = np.interp(marks, travelled, np.arange(len(points)))
    smooth = np.column_stack([np.interp(steps, np.arange(len(points)), points[:, i]) for i in (0, 1)])
    beyond = onto_lane(lane_map, points[-1], float(log.yaw[row][valid][-1]))
    return ReferencePath.through(np.concatenate([smooth, points[-1:], beyond]))


def onto_lane(lane_map: LaneMap, end: FloatArray, yaw: float) -> FloatArray:
    """Points (m, 2) that continue a path from its `end` (2,) with heading `yaw` [rad] onto the lane's centre line.

    They go straight on if there is no lane at the end.
    """
    if not lane_map.inside_road(end[:1], end[1:])[0]:
        return end + np.arange(3.0 * SPACING, BEYOND, SPACING)[:, None] * np.array([np.cos(yaw), np.sin(yaw)])
    place = lane_map.nearest(end[:1], end[1:], np.array([yaw]))
    beyond = lane_map.path_from(int(place.lane[0]), float(place.s[0]) + 3.0 * SPACING, BEYOND)
    return _shifted(beyond, float(place.d[0]))


def lane_path(lane_map: LaneMap, x: float, y: float, yaw: float, length: float = LANE_LENGTH) -> ReferencePath:
    """Returns the centre line of the lane at the pose `x`, `y` [m], `yaw` [rad], over `length` [m] from there on."""
    place = lane_map.nearest(np.array([x]), np.array([y]), np.array([yaw]))
    return ReferencePath.through(lane_map.path_from(int(place.lane[0]), float(place.s[0]), length))


def route_path(log: Log, lane_map: LaneMap, agent: int, pose: FloatArray) -> ReferencePath:
    """The centre line of the lane at `pose` (3,) x, y [m], yaw [rad], from there on, along the edges of the log.

    It never changes lane; where the lane leaves those edges, it continues straight on.
    """
    edges = logged_edges(log, lane_map, agent)
    return ReferencePath.through(lanes_ahead(lane_map, pose, LANE_LENGTH, edges))


def lane_change_path(lane_map: LaneMap, pose: FloatArray, lane: Lane, reach: float) -> ReferencePath:
    """Path from `pose` (3,) onto the centre line of the adjacent `lane` within `reach` [m], and on along that lane."""
    curve, beyond = lane_change(lane_map, pose, lane, reach)
    return ReferencePath.through(np.concatenate([bezier.points(curve, SPACING), beyond]))


def lane_change(lane_map: LaneMap, pose: FloatArray, lane: Lane, reach: float) -> tuple[FloatArray, FloatArray]:
    """Control points (4, 2) of the curve of a :func:`lane_change_path`, and points (m, 2) of the lane beyond it."""
    beside, _ = ReferencePath(lane.centerline).project(pose[:1], pose[1:2])
    far = max(reach, CHANGE_MIN)
    guide = ReferencePath.through(lane_map.path_from(lane_map.row(lane.id), float(beside[0]), far + LANE_LENGTH))
    end = np.array([*guide.point(far), guide.heading(np.array([far]))[0]])
    return bezier.between(pose, end), guide.points[guide.s > far + 0.5 * SPACING]


def _shifted(points: FloatArray, left: float) -> FloatArray:
    """Returns a polyline moved to the left by `left` [m], which fades to zero in proportion to the arc length."""
    travelled = arc_lengths(points)
    direction = np.gradient(points, axis=0)
    direction /= np.hypot(direction[:, 0], direction[:, 1])[:, None]
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    return points + (left * (1.0 - travelled / travelled[-1]))[:, None] * normal


def pursuit_reach(speed: FloatArray) -> FloatArray:
    """Distance (...) [m] to the pursued point at `speed` (...) [m/s]: one second ahead, but at least 4 m."""
    return np.maximum(4.0, speed)


def pursuit_yaw_rate(path: ReferencePath, x: float, y: float, yaw: float, speed: float) -> float:
    """Returns yaw rate [rad/s] of a pure pursuit of `path` (Coulter 1992) from a pose, at `speed` [m/s]."""
    s, _ = path.project(np.array([x]), np.array([y]))
    pose = np.array([x, y, yaw, speed])
    target = path.point(float(s[0] + pursuit_reach(pose[3:])[0]))
    return float(towards(target[None], pose[:1], pose[1:2], pose[2:3], pose[3:])[0])


def towards(target: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, speed: FloatArray) -> FloatArray:
    """Returns yaw rate (...) [rad/s] of the arc from poses (...) through `target` (..., 2) at `speed` (...) [m/s]."""
    dx, dy = target[..., 0] - x, target[..., 1] - y
    return np.asarray(2.0 * speed * np.sin(np.arctan2(dy, dx) - yaw) / np.hypot(dx, dy))


def window(path: ReferencePath, x: float, y: float) -> ReferencePath:
    """The part of `path` around a position in frame map [m] that takeovers contain (:meth:`.PathBatch.window`)."""
    s, _ = path.project(np.array([x]), np.array([y]))
    (begin,), (end,) = path.batch.window(s)
    return ReferencePath(path.points[begin:end])
