"""Vehicles that follow reference paths, with the quantities that several rules need, each computed once for all."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from litsim_policy.motion.along_path import AlongPath, PoseArrays, Poses, ahead_in_path, along_paths
from litsim_policy.motion.car_following import Leaders
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import pursuit_reach, towards
from litsim_sim.core.scene import AgentTable, FloatArray, IntArray
from litsim_sim.core.takeover import Takeover
from litsim_sim.lane_map.lane_map import LaneMap, LanePosition


class PathFollowers:
    """m of the n agents of a table, each with its own path. Arrays are (m,) unless stated otherwise.

    Attributes:
        table: all agents.
        rows: of the followers in `table`.
        paths: m paths.
        own: poses of the followers. If `poses` are given, they replace the follower's own pose in its view, while the
            other agents are at their poses in `table`.
        x, y, yaw, speed: of the followers [m], [rad], [m/s].
    """

    def __init__(
        self, lane_map: LaneMap, table: AgentTable, rows: IntArray, paths: PathBatch, poses: Poses | None = None
    ) -> None:
        self.table, self.rows, self.paths = table, rows, paths
        self.own = PoseArrays(*(poses or (table.x[rows], table.y[rows], table.yaw[rows])))
        self.x, self.y, self.yaw = self.own
        self.speed = table.speed[rows]
        self._lane_map = lane_map
        self._view: AlongPath | None = None

    @classmethod
    def of_takeovers(cls, lane_map: LaneMap, table: AgentTable, takeovers: Sequence[Takeover]) -> PathFollowers:
        """Returns the agents of `takeovers`, all of which must be in `table`, on their reference paths."""
        rows = table.rows(np.array([t.agent for t in takeovers], np.int64))
        return cls(lane_map, table, rows, PathBatch.of([t.reference_path for t in takeovers]))

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def view(self) -> AlongPath:
        """All agents of the scenes relative to the followers, (m, w)."""
        if self._view is None:
            self._view = along_paths(self.paths, self.table, self.rows, poses=self.own)
        return self._view

    @cached_property
    def _ahead(self) -> tuple[Leaders, FloatArray, FloatArray]:
        """As :func:`.ahead_in_path`; of the view, where that exists anyway."""
        if (view := self._view) is not None:
            leads = view.ahead & view.in_path
            return Leaders(view.gap, view.speed, leads, view.first, self.table.acceleration), view.own_s, view.own_d
        return ahead_in_path(self.paths, self.table, self.rows, self.own)

    @property
    def leaders(self) -> Leaders:
        """The agents ahead on the followers' paths; gaps to others and their speeds are undefined."""
        return self._ahead[0]

    @property
    def s(self) -> FloatArray:
        """Arc length of the followers on their paths [m]."""
        return self._ahead[1]

    @property
    def d(self) -> FloatArray:
        """Offset of the followers from their paths, to the left [m]."""
        return self._ahead[2]

    @cached_property
    def lane(self) -> LanePosition:
        """Positions of the followers on their nearest lanes."""
        return self._lane_map.nearest(self.x, self.y, self.yaw)

    @cached_property
    def reach(self) -> FloatArray:
        """Distance along the path to the pursued point [m]."""
        return pursuit_reach(self.speed)

    @cached_property
    def target(self) -> FloatArray:
        """Pursued points (m, 2) in frame map [m]."""
        return self.paths.point(self.s + self.reach)

    @cached_property
    def path_yaw_rate(self) -> FloatArray:
        """Yaw rate of a pure pursuit of the path [rad/s]."""
        return towards(self.target, self.x, self.y, self.yaw, self.speed)

    @cached_property
    def lane_yaw_rate(self) -> FloatArray:
        """Yaw rate that aligns the followers with their lanes, whatever their offset [rad/s]."""
        return 2.0 * self.speed / self.reach * np.sin(self.lane.heading - self.yaw)

    def to_goal(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Returns the distance along the paths from the followers to the positions `x`, `y`, one for each [m]."""
        x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
        return self.paths.project(np.arange(len(self)), x, y).s - self.s
