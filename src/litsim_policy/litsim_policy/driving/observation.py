"""What policy C sees: the features of the paper's Table I, and where the agent is on the way to its goal.

Everything is seen from the agents' box centres, divided by fixed scales and cut to +-LIMIT, float64. The groups:

- core (4): length, width, speed, acceleration. The paper's table has "height" for the second extent of the box.
- surrounding (7 per slot): present, distance of the front ends, speed, sine and cosine of the bearing, sine and cosine
  of the relative heading. A slot without an agent is all zeros.
- road (7): left and right lane marking, left and right road edge, lane offset, curvature, heading to the lane.
- way (14): see :data:`WAY_FEATURES`; the paper has the policy drive along the reference path to the goal, but does not
  say how it is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from litsim_policy.conflict.takeover import PATH_AHEAD, PATH_BEHIND
from litsim_policy.motion.car_following import along_path
from litsim_policy.motion.reference_path import ReferencePath, pursuit_reach, pursuit_yaw_rate
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.takeover import Takeover
from litsim_sim.maps.lane_map import LaneMap

LIMIT = 3.0  # features are cut to +-LIMIT after scaling
LENGTH, WIDTH = 5.0, 2.0  # [m]
SPEED = 15.0  # [m/s]
ACCELERATION = 3.0  # [m/s2]
DISTANCE = 30.0  # [m] to agents and along the path
LATERAL = 3.66  # [m] a lane of NGSIM
EDGE = 10.0  # [m] to the edges of the road
CURVATURE = 0.05  # [1/m]
HEADING = 0.2  # [rad] to lane and path
YAW_RATE = 0.2  # [rad/s]
TIME = 5.0  # [s]

CORE, SLOT, ROAD, WAY = 4, 7, 7, 14
WAY_FEATURES = (
    "offset from the path",
    "heading to the path",
    "heading of the path half a pursuit reach ahead",
    "heading of the path one and a half reaches ahead",
    "yaw rate of a pure pursuit of the path",
    "somebody is on the path",
    "gap to the first one on the path",
    "speed of that one less the own",
    "distance to the goal along the path",
    "time until the agent was expected at the goal",
    "the opponent is there",
    "opponent ahead",
    "opponent to the left",
    "speed of the opponent less the own",
)


@dataclass(frozen=True)
class DrivingTask:
    """Where an agent under policy C is going.

    Attributes:
        agent: id.
        path: reference path.
        goal: (2,) the conflict's crossing point, x and y in frame map [m].
        due_step: step at which the agent, had it followed its log, was expected there.
        opponent: id of the agent that it is in conflict with; -1 is nobody.
    """

    agent: int
    path: ReferencePath
    goal: FloatArray
    due_step: int
    opponent: int = -1

    @classmethod
    def of(cls, takeover: Takeover) -> DrivingTask:
        """DrivingTask of an agent that was taken over."""
        due = takeover.detected_step + round(takeover.time_to_conflict / STEP_S)
        path = ReferencePath.of(takeover.reference_path)
        opponent = takeover.opponent if takeover.opponent != takeover.agent else -1
        return cls(takeover.agent, path, np.array(takeover.goal_pose[:2]), due, opponent)


@dataclass(frozen=True)
class ObservationConfig:
    """How surrounding agents are chosen.

    Attributes:
        arrange: `sector` sees the nearest agent in each of `slots` equal sectors, the first centred ahead, then
            counter-clockwise; `distance` sees the `slots` nearest agents, nearest first.
        slots: k.
        sight: [m] beyond which nobody is seen.
    """

    arrange: Literal["sector", "distance"] = "sector"
    slots: int = 8
    sight: float = 60.0

    @property
    def size(self) -> int:
        """Number of features."""
        return CORE + SLOT * self.slots + ROAD + WAY


class Observer:
    """Observes agents on a net; holds nothing of a run."""

    def __init__(self, lane_map: LaneMap, config: ObservationConfig | None = None) -> None:
        self.config = config or ObservationConfig()
        self._lane_map = lane_map
        lanes = lane_map.lanes
        self._half_width = 0.5 * np.array([lane.width for lane in lanes])
        self._to_left = np.array([_beyond(lane_map, row, "left") for row in range(len(lanes))])
        self._to_right = np.array([_beyond(lane_map, row, "right") for row in range(len(lanes))])

    def observe(self, table: AgentTable, tasks: Sequence[DrivingTask]) -> FloatArray:
        """Features (m, size) of the agents with `tasks` (m), all of which are in `table`."""
        rows = table.rows(np.array([task.agent for task in tasks], np.int64))
        way = [self._way(table, row, task) for row, task in zip(rows.tolist(), tasks, strict=True)]
        groups = [
            _core(table, rows),
            self._surrounding(table, rows),
            self._road(table, rows),
            np.array(way).reshape(len(rows), WAY),
        ]
        return np.clip(np.concatenate(groups, axis=1), -LIMIT, LIMIT)

    def road_clearance(self, table: AgentTable, rows: IntArray) -> FloatArray:
        """(m,) distance [m] from the agents' sides to the nearer edge of the road; negative beyond it."""
        at = self._lane_map.nearest(table.x[rows], table.y[rows], table.yaw[rows])
        half = self._half_width[at.lane]
        left = half + self._to_left[at.lane] - at.d
        right = half + self._to_right[at.lane] + at.d
        return np.minimum(left, right) - 0.5 * table.width[rows]

    def _surrounding(self, table: AgentTable, rows: IntArray) -> FloatArray:
        """(m, slots * SLOT)."""
        dx, dy = table.x[None] - table.x[rows, None], table.y[None] - table.y[rows, None]
        ahead, left = to_body(dx, dy, table.yaw[rows, None])
        turn = table.yaw[None] - table.yaw[rows, None]
        front = 0.5 * table.length
        apart = np.hypot(ahead + front[None] * np.cos(turn) - front[rows, None], left + front[None] * np.sin(turn))
        seen = np.hypot(dx, dy) <= self.config.sight
        seen[np.arange(len(rows)), rows] = False
        bearing = np.arctan2(left, ahead)
        chosen = self._chosen(apart, bearing, seen)
        present = chosen >= 0
        at = np.where(present, chosen, 0)
        line = np.arange(len(rows))[:, None]
        features = np.stack(
            [
                np.ones(at.shape),
                apart[line, at] / DISTANCE,
                table.speed[at] / SPEED,
                np.sin(bearing[line, at]),
                np.cos(bearing[line, at]),
                np.sin(turn[line, at]),
                np.cos(turn[line, at]),
            ],
            axis=-1,
        )
        return np.where(present[..., None], features, 0.0).reshape(len(rows), self.config.slots * SLOT)

    def _chosen(self, apart: FloatArray, bearing: FloatArray, seen: BoolArray) -> IntArray:
        """(m, slots) columns of the agents that fill the slots, -1 where nobody does; ties go to the lower id."""
        slots = self.config.slots
        distance = np.where(seen, apart, np.inf)
        if self.config.arrange == "distance":
            order = np.argsort(distance, axis=1, kind="stable")[:, :slots]
            order = np.pad(order, ((0, 0), (0, slots - order.shape[1])))
            near = np.take_along_axis(distance, order, axis=1)
            count = np.minimum(seen.sum(axis=1), slots)[:, None]
            return np.where(np.isfinite(near) & (np.arange(slots) < count), order, -1)
        sector = np.floor(bearing / (2.0 * np.pi / slots) + 0.5).astype(np.int64) % slots
        by_sector = np.where(sector[:, None, :] == np.arange(slots)[None, :, None], distance[:, None, :], np.inf)
        nearest = np.argmin(by_sector, axis=2)
        return np.where(np.isfinite(by_sector.min(axis=2)), nearest, -1)

    def _road(self, table: AgentTable, rows: IntArray) -> FloatArray:
        """(m, ROAD)."""
        at = self._lane_map.nearest(table.x[rows], table.y[rows], table.yaw[rows])
        half = self._half_width[at.lane]
        marker_left, marker_right = half - at.d, half + at.d
        _, _, behind = self._lane_map.pose_at(at.lane, at.s - 5.0)
        _, _, before = self._lane_map.pose_at(at.lane, at.s + 5.0)
        return np.column_stack(
            [
                marker_left / LATERAL,
                marker_right / LATERAL,
                (marker_left + self._to_left[at.lane]) / EDGE,
                (marker_right + self._to_right[at.lane]) / EDGE,
                at.d / LATERAL,
                wrap_angle(before - behind) / 10.0 / CURVATURE,
                wrap_angle(table.yaw[rows] - at.heading) / HEADING,
            ]
        )

    def _way(self, table: AgentTable, row: int, task: DrivingTask) -> list[float]:
        """(WAY,) features in the order of WAY_FEATURES."""
        path, speed = task.path, float(table.speed[row])
        x, y, yaw = float(table.x[row]), float(table.y[row]), float(table.yaw[row])
        s, d = path.project(np.array([x, task.goal[0]]), np.array([y, task.goal[1]]))
        reach = pursuit_reach(speed)
        heading = wrap_angle(path.heading(s[0] + reach * np.array([0.0, 0.5, 1.5])) - yaw) / HEADING
        view = along_path(path, table, row)
        leads = np.flatnonzero(view.ahead & view.in_path & (view.gap < self.config.sight))
        lead = [0.0, 0.0, 0.0]
        if len(leads):
            first = leads[np.argmin(view.gap[leads])]
            lead = [1.0, float(view.gap[first]) / DISTANCE, float(view.speed[first] - speed) / SPEED]
        other, opponent = table.row(task.opponent), [0.0, 0.0, 0.0, 0.0]
        if other >= 0:
            ahead, left = to_body(table.x[other] - x, table.y[other] - y, table.yaw[row])
            along = float(table.speed[other]) * np.cos(float(table.yaw[other]) - yaw)
            opponent = [1.0, float(ahead) / DISTANCE, float(left) / LATERAL, (along - speed) / SPEED]
        return [
            float(d[0]) / LATERAL,
            *heading.tolist(),
            pursuit_yaw_rate(path, x, y, yaw, speed) / YAW_RATE,
            *lead,
            float(s[1] - s[0]) / DISTANCE,
            (task.due_step - table.step) * STEP_S / TIME,
            *opponent,
        ]


def _core(table: AgentTable, rows: IntArray) -> FloatArray:
    """(m, CORE)."""
    return np.column_stack(
        [
            table.length[rows] / LENGTH,
            table.width[rows] / WIDTH,
            table.speed[rows] / SPEED,
            table.acceleration[rows] / ACCELERATION,
        ]
    )


def _beyond(lane_map: LaneMap, row: int, side: Literal["left", "right"]) -> float:
    """Width [m] of the lanes of the same edge that lie beyond the lane at `row` to that side."""
    width, beside = 0.0, getattr(lane_map.lanes[row], side)
    while beside is not None:
        lane = lane_map.lanes[lane_map.row(beside)]
        width, beside = width + lane.width, getattr(lane, side)
    return width


def window(path: ReferencePath, x: float, y: float) -> ReferencePath:
    """The part of `path` from a little behind a place on it, as takeovers carry it."""
    s, _ = path.project(np.array([x]), np.array([y]))
    kept = (path.s >= s[0] - PATH_BEHIND) & (path.s <= s[0] + PATH_AHEAD)
    return ReferencePath.of(path.points[kept] if kept.sum() >= 2 else path.points[-2:])
