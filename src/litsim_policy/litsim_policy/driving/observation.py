"""Observations of policy C: the features of the paper's Table I, and the way to the agent's goal.

All features are relative to the agents' box centres, divided by fixed scales and clipped to +-LIMIT, float64. The
groups:

- core (4): length, width, speed, acceleration. The paper's table has "height" for the second extent of the box.
- surrounding (7 per slot): present, distance of the front ends, speed, sine and cosine of the bearing, sine and cosine
  of the relative heading. A slot without an agent is all zeros.
- road (7): left and right lane marking, left and right road edge, lane offset, curvature, heading to the lane.
- ahead (6, optional): agents ahead on the path, see :data:`AHEAD_FEATURES`.
- way (14): see :data:`WAY_FEATURES`; in the paper the policy drives along the reference path to the goal, but the
  paper does not describe these features.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numba.types import Tuple, UniTuple

from litsim_policy.driving.safety import SafetyConfig, following_cap
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.car_following import Poses
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.path_kernels import UNIT_X, UNIT_Y, segment_at
from litsim_sim.core.compiled import (
    BOOLS2,
    FLOATS,
    FLOATS2,
    FLOATS3,
    INTS,
    OUT_FLOATS,
    OUT_FLOATS2,
    OUT_INTS,
    boolean,
    float64,
    int64,
    kernel,
    void,
)
from litsim_sim.core.pair_geometry import within_scenes, wrapped
from litsim_sim.core.quantities import Flag, Length, Positive, Whole, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.maps.lane_map import LaneMap

LIMIT = 3.0  # features are clipped to +-LIMIT after scaling
# scales by which features are divided
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
FORESEEN = SafetyConfig(own_braking=4.0, leader_braking=5.0, imminent=1.0)
"""Parameters of the feature "safe acceleration behind the leaders", with braking that the network may command."""
CURVE_LENGTH = 10.0  # [m] length of lane around the agent over which its curvature is measured

CORE, SLOT, ROAD, AHEAD, WAY = 4, 7, 7, 6, 14
AHEAD_FEATURES = (
    "acceleration of the leader",
    "safe acceleration behind the leaders",
    "second leader present",
    "gap to the second leader",
    "speed of the second leader less the own",
    "acceleration of the second leader",
)
"""Leaders are agents ahead on the path; the rear of the second one is ahead of the first one's centre."""
WAY_FEATURES = (
    "offset from the path",
    "heading to the path",
    "heading of the path half a pursuit reach ahead",
    "heading of the path one and a half reaches ahead",
    "yaw rate of a pure pursuit of the path",
    "leader present",
    "gap to the leader",
    "speed of the leader less the own",
    "distance to the goal along the path",
    "time until the agent was expected at the goal",
    "opponent present",
    "opponent ahead",
    "opponent to the left",
    "speed of the opponent less the own",
)


@configuration
class ObservationConfig:
    """How surrounding agents are chosen.

    Attributes:
        arrange: `sector` for the nearest agent in each of `slots` equal sectors, the first centred ahead, then
            counter-clockwise; `distance` for the `slots` nearest agents, nearest first.
        slots: number of observed agents.
        sight: range beyond which agents are ignored.
        ahead: whether :data:`AHEAD_FEATURES` are included.
    """

    arrange: Literal["sector", "distance"] = "sector"
    slots: Positive[Whole] = 8
    sight: Positive[Length] = 60.0
    ahead: Flag = False

    @property
    def size(self) -> int:
        """Number of features."""
        return self.ahead_at + (AHEAD if self.ahead else 0) + WAY

    @property
    def ahead_at(self) -> int:
        """Position of the first of :data:`AHEAD_FEATURES`, if they are included."""
        return CORE + SLOT * self.slots + ROAD


class LaneFeatures:
    """The ROAD features of agents: markings, edges, offset and heading in the lane, and its curvature."""

    def __init__(self, lane_map: LaneMap) -> None:
        self._lane_map = lane_map
        lanes = lane_map.lanes
        self._half_width = 0.5 * np.array([lane.width for lane in lanes])
        self._to_left = np.array([_beyond(lane_map, row, "left") for row in range(len(lanes))])
        self._to_right = np.array([_beyond(lane_map, row, "right") for row in range(len(lanes))])

    def write(self, agents: PathFollowers, first: int, features: FloatArray) -> None:
        """Write the features of `agents` into `features` (m, size), from the position `first` on."""
        at = agents.lane
        around = self._lane_map.headings_around(at.lane, at.s, 0.5 * CURVE_LENGTH)
        sides = self._half_width, self._to_left, self._to_right
        _see_road(at.lane, at.d, at.heading, around, agents.yaw, *sides, first, features)


class Observer:
    """Observes agents on a net; independent of runs."""

    def __init__(self, lane_map: LaneMap, config: ObservationConfig | None = None) -> None:
        self.config = config or ObservationConfig()
        self._lane_map, self._road = lane_map, LaneFeatures(lane_map)

    def observe(self, table: AgentTable, tasks: Sequence[DrivingTask], poses: Poses | None = None) -> FloatArray:
        """Features (m, size) of the agents with `tasks` (m), all of which are in `table`.

        If `poses` are given, each agent is observed as if it alone were displaced to its pose.
        """
        return self.features(DrivingScene.of(self._lane_map, table, tasks, poses))

    def features(self, scene: DrivingScene) -> FloatArray:
        """Features (m, size) of the m agents of `scene`."""
        features = np.zeros((len(scene), self.config.size))
        if len(scene):
            table, rows = scene.agents.table, scene.agents.rows
            _see_core(table.length, table.width, table.speed, table.acceleration, rows, features)
            self._see_surrounding(scene.agents, features)
            self._road.write(scene.agents, CORE + SLOT * self.config.slots, features)
            if self.config.ahead:
                self._see_ahead(scene.agents, features)
            self._see_way(scene, features)
            np.minimum(np.maximum(features, -LIMIT, out=features), LIMIT, out=features)
        return features

    def _see_surrounding(self, agents: PathFollowers, features: FloatArray) -> None:
        """Write the features of the surrounding agents."""
        table, config = agents.table, self.config
        viewer, agent, ahead, left = _seen(
            table.scene, table.x, table.y, agents.rows, agents.x, agents.y, agents.yaw, config.sight
        )
        _see_surrounding(
            viewer,
            agent,
            ahead,
            left,
            np.arctan2(left, ahead),
            agents.rows,
            agents.yaw,
            table.yaw,
            table.speed,
            table.length,
            config.arrange == "sector",
            config.slots,
            features,
        )

    def _see_ahead(self, agents: PathFollowers, features: FloatArray) -> None:
        """Write the features of agents ahead on the paths, in the order of AHEAD_FEATURES."""
        view, sight = agents.view, self.config.sight
        features[:, self.config.ahead_at + 1] = following_cap(FORESEEN, agents) / ACCELERATION
        _see_ahead(
            view.gap,
            view.speed,
            view.ahead,
            view.in_path,
            view.first,
            agents.table.length,
            agents.table.acceleration,
            agents.speed,
            sight,
            self.config.ahead_at,
            features,
        )

    def _see_way(self, scene: DrivingScene, features: FloatArray) -> None:
        """Write the features of the way to the goal, in the order of WAY_FEATURES."""
        agents, table, view = scene.agents, scene.agents.table, scene.agents.view
        unit_x, unit_y = path_directions(agents.paths, agents.s, agents.reach)
        _see_path(
            agents.d,
            np.arctan2(unit_y, unit_x),
            agents.yaw,
            agents.path_yaw_rate,
            agents.to_goal(scene.goal[:, 0], scene.goal[:, 1]),
            scene.due_step - table.step,
            features,
        )
        _see_leader(view.gap, view.speed, view.ahead, view.in_path, agents.speed, self.config.sight, features)
        _see_opponent(
            table.x,
            table.y,
            table.yaw,
            table.speed,
            table.rows(scene.opponent),
            agents.x,
            agents.y,
            agents.yaw,
            agents.speed,
            features,
        )


@kernel(void(FLOATS, FLOATS, FLOATS, FLOATS, INTS, OUT_FLOATS2))
def _see_core(
    length: FloatArray,
    width: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    rows: IntArray,
    features: FloatArray,
) -> None:
    """Write the core features of the agents in `rows` (m,) of a table into `features` (m, size)."""
    for i in range(len(rows)):
        own = rows[i]
        features[i, 0], features[i, 1] = length[own] / LENGTH, width[own] / WIDTH
        features[i, 2], features[i, 3] = speed[own] / SPEED, acceleration[own] / ACCELERATION


@kernel(
    Tuple((OUT_INTS, OUT_INTS, OUT_FLOATS, OUT_FLOATS))(INTS, FLOATS, FLOATS, INTS, FLOATS, FLOATS, FLOATS, float64)
)
def _seen(
    scene: IntArray,
    x: FloatArray,
    y: FloatArray,
    rows: IntArray,
    own_x: FloatArray,
    own_y: FloatArray,
    own_yaw: FloatArray,
    sight: float,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Pairs of observing agents and agents within their sight.

    Args:
        scene: (n,) scene of each agent; only agents of one scene form pairs.
        x, y: (n,) of all agents [m].
        rows: (m,) of the observers.
        own_x, own_y, own_yaw: (m,) poses of the observers [m], [rad].
        sight: range of sight [m].

    Returns:
        k pairs, ordered by the observer: position of the observer in `rows` and row of the other agent, both (k,), and
        the distances of the latter ahead and to the left (k,) [m].
    """
    begin, end = within_scenes(scene, rows)
    most = (end - begin).sum()
    viewer, agent, ahead, left = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most), np.empty(most)
    k = 0
    for i in range(len(rows)):
        cos, sin = math.cos(own_yaw[i]), math.sin(own_yaw[i])
        for j in range(begin[i], end[i]):
            dx, dy = x[j] - own_x[i], y[j] - own_y[i]
            if j != rows[i] and math.hypot(dx, dy) <= sight:
                viewer[k], agent[k] = i, j
                ahead[k], left[k] = dx * cos + dy * sin, dy * cos - dx * sin
                k += 1
    return viewer[:k], agent[:k], ahead[:k], left[:k]


@kernel(void(INTS, INTS, FLOATS, FLOATS, FLOATS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, boolean, int64, OUT_FLOATS2))
def _see_surrounding(  # noqa: PLR0917 - a kernel takes arrays and numbers
    viewer: IntArray,
    agent: IntArray,
    ahead: FloatArray,
    left: FloatArray,
    bearing: FloatArray,
    rows: IntArray,
    own_yaw: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    by_sector: bool,
    slots: int,
    features: FloatArray,
) -> None:
    """Write the surrounding agents: the nearest per sector, or the nearest of all; of equally near ones the lower row.

    Args:
        viewer, agent, ahead, left: k pairs from :func:`_seen`.
        bearing: (k,) of the agents relative to the observers' headings [rad].
        rows, own_yaw: (m,) of the observers, and their headings [rad].
        yaw, speed, length: (n,) of all agents [rad], [m/s], [m].
        by_sector: whether each slot is a sector.
        slots: number of slots.
        features: (m, size) written to.
    """
    chosen = np.full((len(rows), slots), -1, np.int64)
    near = np.full((len(rows), slots), np.inf)
    for k in range(len(viewer)):
        i, turn = viewer[k], yaw[agent[k]] - own_yaw[viewer[k]]
        front, own_front = 0.5 * length[agent[k]], 0.5 * length[rows[i]]
        apart = math.hypot(ahead[k] + front * math.cos(turn) - own_front, left[k] + front * math.sin(turn))
        if by_sector:
            at = int(np.floor(bearing[k] / (2.0 * math.pi / slots) + 0.5)) % slots
            if apart < near[i, at]:
                chosen[i, at], near[i, at] = k, apart
            continue
        at = slots
        while at > 0 and apart < near[i, at - 1]:
            at -= 1
        for later in range(slots - 1, at, -1):
            chosen[i, later], near[i, later] = chosen[i, later - 1], near[i, later - 1]
        if at < slots:
            chosen[i, at], near[i, at] = k, apart
    for i in range(len(rows)):
        for at in range(slots):
            k, first = chosen[i, at], CORE + SLOT * at
            if k < 0:
                continue
            turn = yaw[agent[k]] - own_yaw[i]
            features[i, first] = 1.0
            features[i, first + 1] = near[i, at] / DISTANCE
            features[i, first + 2] = speed[agent[k]] / SPEED
            features[i, first + 3], features[i, first + 4] = math.sin(bearing[k]), math.cos(bearing[k])
            features[i, first + 5], features[i, first + 6] = math.sin(turn), math.cos(turn)


@kernel(void(INTS, FLOATS, FLOATS, FLOATS2, FLOATS, FLOATS, FLOATS, FLOATS, int64, OUT_FLOATS2))
def _see_road(  # noqa: PLR0917 - a kernel takes arrays and numbers
    lane: IntArray,
    d: FloatArray,
    lane_heading: FloatArray,
    around: FloatArray,
    yaw: FloatArray,
    half_width: FloatArray,
    to_left: FloatArray,
    to_right: FloatArray,
    first: int,
    features: FloatArray,
) -> None:
    """Write the ROAD features of m agents.

    Args:
        lane, d, lane_heading: (m,) as in :class:`litsim_sim.maps.lane_map.LanePosition`.
        around: (m, 2) heading of the lane half of CURVE_LENGTH behind and ahead [rad].
        yaw: (m,) of the agents [rad].
        half_width: of all lanes [m].
        to_left, to_right: width of the road beyond each lane [m].
        first: position of the first feature.
        features: (m, size) written to.
    """
    for i in range(len(lane)):
        marker_left, marker_right = half_width[lane[i]] - d[i], half_width[lane[i]] + d[i]
        features[i, first] = marker_left / LATERAL
        features[i, first + 1] = marker_right / LATERAL
        features[i, first + 2] = (marker_left + to_left[lane[i]]) / EDGE
        features[i, first + 3] = (marker_right + to_right[lane[i]]) / EDGE
        features[i, first + 4] = d[i] / LATERAL
        features[i, first + 5] = wrapped(around[i, 1] - around[i, 0]) / CURVE_LENGTH / CURVATURE
        features[i, first + 6] = wrapped(yaw[i] - lane_heading[i]) / HEADING


def path_directions(paths: PathBatch, s: FloatArray, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors along `paths`, x and y (m, 3): at `s` (m,), and half a `reach` (m,) and one and a half ahead."""
    return _directions(paths.segments, paths.count, s, reach)


@kernel(UniTuple(OUT_FLOATS2, 2)(FLOATS3, INTS, FLOATS, FLOATS))
def _directions(
    segments: FloatArray, count: IntArray, s: FloatArray, reach: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Directions of m paths where the agents are, and half a reach and one and a half ahead.

    Args:
        segments, count: of the paths, see :mod:`litsim_policy.motion.path_kernels`.
        s, reach: (m,) arc lengths of the agents and their pursuit reaches [m].

    Returns:
        x and y (m, 3) of unit vectors.
    """
    unit_x, unit_y = np.empty((len(s), 3)), np.empty((len(s), 3))
    for i in range(len(s)):
        for k, share in enumerate((0.0, 0.5, 1.5)):
            at = segment_at(segments, count[i], i, s[i] + reach[i] * share)
            unit_x[i, k], unit_y[i, k] = segments[i, at, UNIT_X], segments[i, at, UNIT_Y]
    return unit_x, unit_y


@kernel(void(FLOATS, FLOATS2, FLOATS, FLOATS, FLOATS, INTS, OUT_FLOATS2))
def _see_path(
    d: FloatArray,
    heading: FloatArray,
    yaw: FloatArray,
    yaw_rate: FloatArray,
    to_goal: FloatArray,
    steps_left: IntArray,
    features: FloatArray,
) -> None:
    """Write the features of m agents on the way to their goals.

    Args:
        d: (m,) offsets from the paths [m].
        heading: (m, 3) of the paths, at the positions of :func:`_directions` [rad].
        yaw: (m,) of the agents [rad].
        yaw_rate: (m,) of a pure pursuit of the paths [rad/s].
        to_goal: (m,) distance along the paths [m].
        steps_left: (m,) until the agents were expected at their goals.
        features: (m, size) written to.
    """
    first = features.shape[1] - WAY
    for i in range(len(d)):
        features[i, first] = d[i] / LATERAL
        for k in range(3):
            features[i, first + 1 + k] = wrapped(heading[i, k] - yaw[i]) / HEADING
        features[i, first + 4] = yaw_rate[i] / YAW_RATE
        features[i, first + 8] = to_goal[i] / DISTANCE
        features[i, first + 9] = steps_left[i] * STEP_S / TIME


@kernel(int64(FLOATS2, BOOLS2, BOOLS2, int64, float64, float64))
def _next_on_path(gap: FloatArray, ahead: BoolArray, in_path: BoolArray, i: int, beyond: float, sight: float) -> int:
    """Column of the nearest leader of agent `i` with a gap of more than `beyond` and less than `sight` [m], or -1.

    The arrays (m, w) are those of :class:`litsim_policy.motion.car_following.AlongPath`.
    """
    found, least = -1, sight
    for j in range(gap.shape[1]):
        if ahead[i, j] and in_path[i, j] and beyond < gap[i, j] < least:
            found, least = j, gap[i, j]
    return found


@kernel(void(FLOATS2, FLOATS2, BOOLS2, BOOLS2, INTS, FLOATS, FLOATS, FLOATS, float64, int64, OUT_FLOATS2))
def _see_ahead(  # noqa: PLR0917 - a kernel takes arrays and numbers
    gap: FloatArray,
    along: FloatArray,
    ahead: BoolArray,
    in_path: BoolArray,
    begin: IntArray,
    length: FloatArray,
    acceleration: FloatArray,
    speed: FloatArray,
    sight: float,
    first: int,
    features: FloatArray,
) -> None:
    """Write the acceleration of the leader, and the features of the second leader.

    Args:
        gap, along, ahead, in_path: (m, w) as in :class:`litsim_policy.motion.car_following.AlongPath`; `along` is the
            speed there.
        begin: (m,) row of the first of the others.
        length, acceleration: (n,) of all agents [m], [m/s2].
        speed: (m,) of the agents [m/s].
        sight: range of sight [m].
        first: position of the first feature.
        features: (m, size) written to.
    """
    for i in range(len(speed)):
        leader = _next_on_path(gap, ahead, in_path, i, -np.inf, sight)
        if leader < 0:
            continue
        features[i, first] = acceleration[begin[i] + leader] / ACCELERATION
        # an agent alongside the leader does not count as the second one
        beyond = gap[i, leader] + 0.5 * length[begin[i] + leader]
        second = _next_on_path(gap, ahead, in_path, i, beyond, sight)
        if second >= 0:
            features[i, first + 2], features[i, first + 3] = 1.0, gap[i, second] / DISTANCE
            features[i, first + 4] = (along[i, second] - speed[i]) / SPEED
            features[i, first + 5] = acceleration[begin[i] + second] / ACCELERATION


@kernel(void(FLOATS2, FLOATS2, BOOLS2, BOOLS2, FLOATS, float64, OUT_FLOATS2))
def _see_leader(
    gap: FloatArray,
    along: FloatArray,
    ahead: BoolArray,
    in_path: BoolArray,
    speed: FloatArray,
    sight: float,
    features: FloatArray,
) -> None:
    """Write the leader within `sight` [m], of agents with `speed` (m,) [m/s].

    The first four arrays (m, w) are those of :class:`litsim_policy.motion.car_following.AlongPath`.
    """
    first = features.shape[1] - WAY + 5
    for i in range(len(speed)):
        leader = _next_on_path(gap, ahead, in_path, i, -np.inf, sight)
        if leader >= 0:
            features[i, first], features[i, first + 1] = 1.0, gap[i, leader] / DISTANCE
            features[i, first + 2] = (along[i, leader] - speed[i]) / SPEED


@kernel(void(FLOATS, FLOATS, FLOATS, FLOATS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, OUT_FLOATS2))
def _see_opponent(  # noqa: PLR0917 - a kernel takes arrays and numbers
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    opponent: IntArray,
    own_x: FloatArray,
    own_y: FloatArray,
    own_yaw: FloatArray,
    own_speed: FloatArray,
    features: FloatArray,
) -> None:
    """Write the features of the opponents.

    Args:
        x, y, yaw, speed: (n,) of all agents [m], [rad], [m/s].
        opponent: (m,) rows of the opponents; -1 for none.
        own_x, own_y, own_yaw, own_speed: (m,) of the agents.
        features: (m, size) written to.
    """
    first = features.shape[1] - 4
    for i in range(len(opponent)):
        j = opponent[i]
        if j < 0:
            continue
        cos, sin = math.cos(own_yaw[i]), math.sin(own_yaw[i])
        dx, dy = x[j] - own_x[i], y[j] - own_y[i]
        features[i, first] = 1.0
        features[i, first + 1] = (dx * cos + dy * sin) / DISTANCE
        features[i, first + 2] = (dy * cos - dx * sin) / LATERAL
        features[i, first + 3] = (speed[j] * math.cos(yaw[j] - own_yaw[i]) - own_speed[i]) / SPEED


def _beyond(lane_map: LaneMap, row: int, side: Literal["left", "right"]) -> float:
    """Width [m] of the lanes of the same edge beyond the lane in `row`, on that side."""
    width, beside = 0.0, getattr(lane_map.lanes[row], side)
    while beside is not None:
        lane = lane_map.lanes[lane_map.row(beside)]
        width, beside = width + lane.width, getattr(lane, side)
    return width
