"""Features of an agent's way to its goal: its path, its leaders on it, its goal, and its opponent."""

from __future__ import annotations

import math

import numpy as np

from litsim_policy.driving.features.scales import ACCELERATION, DISTANCE, HEADING, LATERAL, SPEED, TIME, YAW_RATE
from litsim_policy.driving.safety.following import following_cap
from litsim_policy.driving.task import DrivingScene
from litsim_policy.motion.along_path import PoseArrays
from litsim_policy.motion.car_following import Leaders
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import directions_ahead
from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.scene import STEP_S, AgentArrays, FloatArray
from litsim_sim.kernels.compiled import Floats, Floats2, Ints, OutFloats2, kernel

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
AHEAD, WAY = 6, 14  # numbers of these features
TASK = 6  # number of the last WAY_FEATURES, which tell the task: from the distance to the goal on


def write_ahead(agents: PathFollowers, sight: float, first: int, features: FloatArray) -> None:
    """Write :data:`AHEAD_FEATURES` of m agents into `features` (m, size), from `first` on; `sight` in metres."""
    features[:, first + 1] = following_cap(agents) / ACCELERATION
    _write_ahead(agents.leaders, agents.table.length, agents.speed, sight, first, features)


def write_way(scene: DrivingScene, sight: float, features: FloatArray) -> None:
    """Write :data:`WAY_FEATURES` of the m agents of `scene` as the last of `features` (m, size); `sight` in metres."""
    agents, table = scene.agents, scene.agents.table
    unit_x, unit_y = directions_ahead(agents.paths, agents.s, agents.reach)
    _write_path(
        agents.d,
        np.arctan2(unit_y, unit_x),
        agents.yaw,
        agents.path_yaw_rate,
        agents.to_goal(scene.goal[:, 0], scene.goal[:, 1]),
        scene.due_step - table.step,
        features,
    )
    _write_leader(agents.leaders, agents.speed, sight, features)
    _write_opponent(table.arrays, table.rows(scene.opponent), agents.own, agents.speed, features)


@kernel
def _write_path(
    d: Floats, heading: Floats2, yaw: Floats, yaw_rate: Floats, to_goal: Floats, steps_left: Ints, features: OutFloats2
) -> None:
    """Write the features of m agents on the way to their goals into `features` (m, size).

    `d` (m,) are offsets from the paths [m], `heading` (m, 3) [rad] those of the paths at the positions of
    :func:`.directions_ahead`, and `yaw_rate` (m,) [rad/s] that of a pure pursuit. The goals are `to_goal` (m,) [m]
    along the paths, where agents were expected in `steps_left` (m,).
    """
    first = features.shape[1] - WAY
    for i in range(len(d)):
        features[i, first] = d[i] / LATERAL
        for k in range(3):
            features[i, first + 1 + k] = wrapped(heading[i, k] - yaw[i]) / HEADING
        features[i, first + 4] = yaw_rate[i] / YAW_RATE
        features[i, first + 8] = to_goal[i] / DISTANCE
        features[i, first + 9] = steps_left[i] * STEP_S / TIME


@kernel
def _next_on_path(leaders: Leaders, i: int, beyond: float, sight: float) -> int:
    """Column of the nearest leader of agent `i` with a gap of more than `beyond` and less than `sight` [m], or -1."""
    nearest, least = -1, sight
    for j in range(leaders.gap.shape[1]):
        if leaders.leads[i, j] and beyond < leaders.gap[i, j] < least:
            nearest, least = j, leaders.gap[i, j]
    return nearest


@kernel
def _write_ahead(
    leaders: Leaders, length: Floats, speed: Floats, sight: float, first: int, features: OutFloats2
) -> None:
    """Write the acceleration of the leader, and features of the second one, into `features` (m, size) from `first` on.

    `length` (n,) [m] is that of all agents, `speed` (m,) [m/s] that of those that look up to `sight` [m].
    """
    for i in range(len(speed)):
        leader = _next_on_path(leaders, i, -np.inf, sight)
        if leader < 0:
            continue
        features[i, first] = leaders.acceleration[leaders.first[i] + leader] / ACCELERATION
        # an agent alongside the leader does not count as the second one
        beyond = leaders.gap[i, leader] + 0.5 * length[leaders.first[i] + leader]
        second = _next_on_path(leaders, i, beyond, sight)
        if second >= 0:
            features[i, first + 2], features[i, first + 3] = 1.0, leaders.gap[i, second] / DISTANCE
            features[i, first + 4] = (leaders.speed[i, second] - speed[i]) / SPEED
            features[i, first + 5] = leaders.acceleration[leaders.first[i] + second] / ACCELERATION


@kernel
def _write_leader(leaders: Leaders, speed: Floats, sight: float, features: OutFloats2) -> None:
    """Write the leader within `sight` [m], of agents with `speed` (m,) [m/s]."""
    first = features.shape[1] - WAY + 5
    for i in range(len(speed)):
        leader = _next_on_path(leaders, i, -np.inf, sight)
        if leader >= 0:
            features[i, first], features[i, first + 1] = 1.0, leaders.gap[i, leader] / DISTANCE
            features[i, first + 2] = (leaders.speed[i, leader] - speed[i]) / SPEED


@kernel
def _write_opponent(
    agents: AgentArrays, opponent: Ints, own: PoseArrays, own_speed: Floats, features: OutFloats2
) -> None:
    """Write the features of the opponents, in the rows `opponent` (m,), -1 for none, into `features` (m, size)."""
    first = features.shape[1] - 4
    for i in range(len(opponent)):
        j = opponent[i]
        if j < 0:
            continue
        cos, sin = math.cos(own.yaw[i]), math.sin(own.yaw[i])
        dx, dy = agents.x[j] - own.x[i], agents.y[j] - own.y[i]
        features[i, first] = 1.0
        features[i, first + 1] = (dx * cos + dy * sin) / DISTANCE
        features[i, first + 2] = (dy * cos - dx * sin) / LATERAL
        features[i, first + 3] = (agents.speed[j] * math.cos(agents.yaw[j] - own.yaw[i]) - own_speed[i]) / SPEED
