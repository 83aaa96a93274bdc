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
from typing import Literal

import numpy as np

from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.car_following import Poses
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.quantities import Length, Positive, Whole, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
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


@configuration
class ObservationConfig:
    """How surrounding agents are chosen.

    Attributes:
        arrange: `sector` sees the nearest agent in each of `slots` equal sectors, the first centred ahead, then
            counter-clockwise; `distance` sees the `slots` nearest agents, nearest first.
        slots: k.
        sight: beyond which nobody is seen.
    """

    arrange: Literal["sector", "distance"] = "sector"
    slots: Positive[Whole] = 8
    sight: Positive[Length] = 60.0

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

    def observe(self, table: AgentTable, tasks: Sequence[DrivingTask], poses: Poses | None = None) -> FloatArray:
        """Features (m, size) of the agents with `tasks` (m), all of which are in `table`.

        Where `poses` are given, each agent is seen as it would be if it alone were displaced to its pose.
        """
        return self.features(DrivingScene.of(self._lane_map, table, tasks, poses))

    def features(self, scene: DrivingScene) -> FloatArray:
        """Features (m, size) of the m agents of `scene`."""
        if not len(scene):
            return np.empty((0, self.config.size))
        table, rows = scene.agents.table, scene.agents.rows
        groups = [_core(table, rows), self._surrounding(scene.agents), self._road(scene.agents), self._way(scene)]
        return np.clip(np.concatenate(groups, axis=1), -LIMIT, LIMIT)

    def _surrounding(self, agents: PathFollowers) -> FloatArray:
        """Features (m, slots * SLOT) of those around the agents."""
        table, rows = agents.table, agents.rows
        own_x, own_y, own_yaw = agents.x[:, None], agents.y[:, None], agents.yaw[:, None]
        seen = np.hypot(table.x - own_x, table.y - own_y) <= self.config.sight
        seen[np.arange(len(rows)), rows] = False
        columns = np.flatnonzero(seen.any(axis=0))
        seen = seen[:, columns]
        ahead, left = to_body(table.x[columns] - own_x, table.y[columns] - own_y, own_yaw)
        turn = table.yaw[columns] - own_yaw
        cos, sin, front = np.cos(turn), np.sin(turn), 0.5 * table.length
        apart = np.hypot(ahead + front[columns] * cos - front[rows, None], left + front[columns] * sin)
        bearing = np.arctan2(left, ahead)
        chosen = self._chosen(apart, bearing, seen)
        present = chosen >= 0
        if not present.any():
            return np.zeros((len(rows), self.config.slots * SLOT))
        at = np.where(present, chosen, 0)
        line = np.arange(len(rows))[:, None]
        features = np.stack(
            [
                np.ones(at.shape),
                apart[line, at] / DISTANCE,
                table.speed[columns][at] / SPEED,
                np.sin(bearing[line, at]),
                np.cos(bearing[line, at]),
                sin[line, at],
                cos[line, at],
            ],
            axis=-1,
        )
        return np.where(present[..., None], features, 0.0).reshape(len(rows), self.config.slots * SLOT)

    def _chosen(self, apart: FloatArray, bearing: FloatArray, seen: BoolArray) -> IntArray:
        """(m, slots) columns of the agents that fill the slots, -1 where nobody does; ties go to the lower id."""
        slots = self.config.slots
        if not seen.shape[1]:
            return np.full((len(seen), slots), -1)
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

    def _road(self, agents: PathFollowers) -> FloatArray:
        """Features (m, ROAD) of the road under the agents."""
        at = agents.lane
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
                wrap_angle(agents.yaw - at.heading) / HEADING,
            ]
        )

    def _way(self, scene: DrivingScene) -> FloatArray:
        """Features (m, WAY) of the ways to the goals, in the order of WAY_FEATURES."""
        agents, table = scene.agents, scene.agents.table
        view, each = agents.view, np.arange(len(agents))
        ahead = agents.s[:, None] + agents.reach[:, None] * np.array([0.0, 0.5, 1.5])
        heading = agents.paths.heading(each[:, None], agents.paths.segment(ahead))
        gap = np.where(view.ahead & view.in_path & (view.gap < self.config.sight), view.gap, np.inf)
        first = np.argmin(gap, axis=1)
        led = np.isfinite(gap[each, first])
        lead = [led, view.gap[each, first] / DISTANCE, (view.speed[each, first] - agents.speed) / SPEED]
        other = table.rows(scene.opponent)
        there = other >= 0
        to_opponent = to_body(table.x[other] - agents.x, table.y[other] - agents.y, agents.yaw)
        along = table.speed[other] * np.cos(table.yaw[other] - agents.yaw)
        opponent = [there, to_opponent[0] / DISTANCE, to_opponent[1] / LATERAL, (along - agents.speed) / SPEED]
        return np.column_stack(
            [
                agents.d / LATERAL,
                wrap_angle(heading - agents.yaw[:, None]) / HEADING,
                agents.path_yaw_rate / YAW_RATE,
                *(np.where(led, values, 0.0) for values in lead),
                agents.to_goal(scene.goal[:, 0], scene.goal[:, 1]) / DISTANCE,
                (scene.due_step - table.step) * STEP_S / TIME,
                *(np.where(there, values, 0.0) for values in opponent),
            ]
        )


def _core(table: AgentTable, rows: IntArray) -> FloatArray:
    """Features (m, CORE) of the agents in `rows` (m,) themselves."""
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
