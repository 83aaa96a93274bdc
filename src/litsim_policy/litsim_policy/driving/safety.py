"""The layer between policy C's network and the vehicle: limits that always hold, and guards that can be switched.

The network may say what it likes; what is commanded keeps comfort bounds, does not run into who is ahead, does not
touch who is beside, and stays on the road, as far as a look ahead can tell. Only a guard may brake harder than is
comfortable. Every intervention is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_policy.driving.observation import DrivingTask
from litsim_policy.motion.car_following import along_path
from litsim_policy.motion.reference_path import pursuit_reach, pursuit_yaw_rate
from litsim_sim.core.geometry import boxes_overlap, to_body
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray
from litsim_sim.maps.lane_map import LaneMap

GUARDS = ("limits", "following", "contact", "road")


@dataclass(frozen=True)
class SafetyConfig:
    """Limits, which always hold, and guards. Bounds are those of nuPlan's comfort measure unless said otherwise.

    Attributes:
        following: brake for who is ahead on the path when braking can no longer wait.
        contact: brake or steer where the command leads into another box within `horizon`.
        road: do not steer off the road.
        acceleration_max, deceleration_max: of what the network commands [m/s2].
        jerk_max: change of the network's acceleration [m/s3].
        lateral_acceleration_max: [m/s2].
        yaw_rate_max: [rad/s].
        yaw_acceleration_max: [rad/s2].
        braking_max: of the guards in an emergency [m/s2]; what the vehicle can do.
        leader_braking: hardest braking that whoever is ahead may start at any time [m/s2].
        own_braking: braking that is relied on then [m/s2].
        standstill_gap: kept behind whoever is ahead [m].
        relax: time constant with which a gap that is too short is widened [s].
        imminent: braking [m/s2] from which on an approach counts as an emergency.
        leader_brakes: braking [m/s2] from which on a leader is taken to stop.
        horizon: [s] of the look ahead.
        settle: time constant with which a turn is expected to end [s].
        margin: [m] kept to other boxes.
        road_horizon: [s] of the look ahead for the road.
    """

    following: bool = True
    contact: bool = True
    road: bool = True
    acceleration_max: float = 2.40
    deceleration_max: float = 4.05
    jerk_max: float = 4.13
    lateral_acceleration_max: float = 4.89
    yaw_rate_max: float = 0.95
    yaw_acceleration_max: float = 1.93
    braking_max: float = 8.0
    leader_braking: float = 8.0
    own_braking: float = 6.0
    standstill_gap: float = 1.0
    relax: float = 0.5
    imminent: float = 2.0
    leader_brakes: float = 1.0
    horizon: float = 1.5
    settle: float = 0.5
    margin: float = 0.15
    road_horizon: float = 0.8


LIMITS_ONLY = SafetyConfig(following=False, contact=False, road=False)
"""What training drives with: the guards only tell what they would have changed, and that costs."""


@dataclass(frozen=True)
class SafeCommands:
    """Commands after the layer; arrays (m,).

    Attributes:
        acceleration: [m/s2].
        yaw_rate: [rad/s].
        changed: (m, 4) which of :data:`GUARDS` changed the command.
    """

    acceleration: FloatArray
    yaw_rate: FloatArray
    changed: BoolArray

    @property
    def guarded(self) -> BoolArray:
        """(m,) whether a guard, not only a limit, intervened."""
        return np.asarray(self.changed[:, 1:].any(axis=1))


class SafetyLayer:
    """Applies to agents on one net; :attr:`interventions` counts agent-steps by guard since it was made."""

    def __init__(self, lane_map: LaneMap, config: SafetyConfig | None = None) -> None:
        self.config = config or SafetyConfig()
        self.interventions = dict.fromkeys(GUARDS, 0)
        self.agent_steps = 0
        self._lane_map = lane_map

    def apply(
        self, table: AgentTable, tasks: Sequence[DrivingTask], acceleration: FloatArray, yaw_rate: FloatArray
    ) -> SafeCommands:
        """What the agents with `tasks` (m) may do of what is asked for.

        Args:
            table: everybody.
            tasks: one for each agent.
            acceleration, yaw_rate: (m,) as asked for [m/s2], [rad/s].
        """
        config = self.config
        rows = table.rows(np.array([task.agent for task in tasks], np.int64))
        changed = np.zeros((len(rows), len(GUARDS)), np.bool_)
        limited_acceleration, limited_yaw_rate = self._limited(table.take(rows), acceleration, yaw_rate)
        changed[:, 0] = (np.abs(limited_acceleration - acceleration) > 1e-9) | (
            np.abs(limited_yaw_rate - yaw_rate) > 1e-9
        )
        safe = np.column_stack([limited_acceleration, limited_yaw_rate])
        for k, (row, task) in enumerate(zip(rows.tolist(), tasks, strict=True)):
            cap = self._following_cap(table, row, task) if config.following else config.acceleration_max
            changed[k, 1] = cap < safe[k, 0]
            safe[k, 0] = min(safe[k, 0], cap)
            if config.contact or config.road:
                safe[k], changed[k, 2], changed[k, 3] = self._guarded(table, row, task, safe[k], cap)
        self.agent_steps += len(rows)
        for name, count in zip(GUARDS, changed.sum(axis=0).tolist(), strict=True):
            self.interventions[name] += count
        return SafeCommands(safe[:, 0], safe[:, 1], changed)

    def _limited(
        self, agents: AgentTable, acceleration: FloatArray, yaw_rate: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Commands (m,) within the comfort bounds, those on the rates of change included.

        What the agent did in the last step may itself be out of bounds; it comes back at the bound of the rate.
        """
        config = self.config
        jerk, twist = config.jerk_max * STEP_S, config.yaw_acceleration_max * STEP_S
        before = np.clip(agents.acceleration, -config.deceleration_max, config.acceleration_max)
        acceleration = np.clip(acceleration, before - jerk, before + jerk)
        acceleration = np.clip(acceleration, -config.deceleration_max, config.acceleration_max)
        yaw_rate = np.clip(yaw_rate, agents.yaw_rate - twist, agents.yaw_rate + twist)
        bound = np.minimum(config.yaw_rate_max, config.lateral_acceleration_max / np.maximum(agents.speed, 1e-3))
        return acceleration, np.clip(yaw_rate, -bound, bound)

    def _following_cap(self, table: AgentTable, row: int, task: DrivingTask) -> float:
        """Acceleration [m/s2] above which the agent could not stop behind whoever is ahead on its path.

        The safe speed is that of Krauss (1997): should the leader brake as hard as it can, braking at `own_braking`
        suffices. It is approached with `relax`. What the approach needs, the leader going on as it does now, is braked
        for at once where it is more than `imminent`.
        """
        config, speed = self.config, float(table.speed[row])
        view = along_path(task.path, table, row)
        leads = view.ahead & view.in_path & (view.gap > -0.5 * table.length[row])
        if not leads.any():
            return config.acceleration_max
        room = view.gap[leads] - config.standstill_gap
        lead_speed = np.maximum(view.speed[leads], 0.0)
        stop = 2.0 * config.own_braking * np.maximum(room, 0.0)
        stop += lead_speed**2 * config.own_braking / config.leader_braking
        lag = config.own_braking * STEP_S
        safe_speed = -lag + np.sqrt(lag**2 + stop)
        cap = (safe_speed - speed) / config.relax
        closing = np.maximum(speed - lead_speed, 0.0)
        needed = closing**2 / (2.0 * np.maximum(room, 0.1))
        braking = np.maximum(-table.acceleration[leads], 0.1)
        stopped = np.where(braking > config.leader_brakes, lead_speed**2 / (2.0 * braking), np.inf)
        needed = np.maximum(needed, speed**2 / (2.0 * np.maximum(room + stopped, 0.1)))
        cap = np.where(needed > config.imminent, np.minimum(cap, -needed), cap)
        return float(np.clip(cap.min(), -config.braking_max, config.acceleration_max))

    def _guarded(
        self, table: AgentTable, row: int, task: DrivingTask, command: FloatArray, cap: float
    ) -> tuple[FloatArray, bool, bool]:
        """The least change to `command` (2,) with which the agent touches nobody and stays on the road.

        Where there is none, the one that touches latest, and of those the one that brakes hardest. `cap` is the
        acceleration that whoever is ahead allows [m/s2].
        """
        first_touch, on_road = self._look_ahead(table, row, command[None])
        touches = self.config.contact and first_touch[0] < np.inf
        leaves = self.config.road and not on_road[0]
        if not touches and not leaves:
            return command, False, False
        choices = self._choices(table, row, task, command, cap)
        touch, stays = self._look_ahead(table, row, choices)
        if not self.config.contact:
            touch[:] = np.inf
        if not self.config.road or not stays.any():
            stays[:] = True
        good = np.flatnonzero((touch == np.inf) & stays)
        order = good if len(good) else np.lexsort((choices[:, 0], -np.where(stays, touch, -1.0)))
        best = int(order[0])
        moved = bool(np.abs(choices[best] - command).max() > 0.0)
        return choices[best], moved and bool(touches), moved and bool(leaves)

    def _choices(self, table: AgentTable, row: int, task: DrivingTask, command: FloatArray, cap: float) -> FloatArray:
        """(15, 2) accelerations and yaw rates: as commanded, along the path, along the lane; then with other speeds.

        The nearest to the commanded acceleration come first. Whoever is cut in on from behind is best off driving on.
        """
        x, y, yaw, speed = (float(getattr(table, f)[row]) for f in ("x", "y", "yaw", "speed"))
        at = self._lane_map.nearest(table.x[row : row + 1], table.y[row : row + 1], table.yaw[row : row + 1])
        along_lane = 2.0 * speed / pursuit_reach(speed) * float(np.sin(at.heading[0] - yaw))
        bound = self.config.lateral_acceleration_max / max(speed, 1e-3)
        twist, now = self.config.yaw_acceleration_max * STEP_S, float(table.yaw_rate[row])
        steering = np.array([command[1], pursuit_yaw_rate(task.path, x, y, yaw, speed), along_lane])
        steering[1:] = np.clip(np.clip(steering[1:], now - twist, now + twist), -bound, bound)
        driving_on = max(min(self.config.acceleration_max, cap), command[0])
        accelerations = np.append(
            np.minimum(command[0], [command[0], -2.0, -4.0, -self.config.braking_max]), driving_on
        )
        accelerations = accelerations[np.argsort(np.abs(accelerations - command[0]), kind="stable")]
        return np.array([[a, rate] for a in accelerations for rate in steering])

    def _look_ahead(self, table: AgentTable, row: int, commands: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Time of the first touch (c,) [s], infinite where there is none, and whether the agent stays on the road (c,).

        The agent keeps the commanded acceleration and ends its turn with `settle`; the others go straight on, and those
        that brake go on braking. Boxes that touch already and followers in the own lane do not count.
        """
        config = self.config
        t: FloatArray = STEP_S * np.arange(1, round(config.horizon / STEP_S) + 1, dtype=np.float64)
        speed = np.maximum(table.speed[row] + commands[:, :1] * t, 0.0)
        yaw = table.yaw[row] + commands[:, 1:] * config.settle * (1.0 - np.exp(-t / config.settle))
        x = table.x[row] + STEP_S * np.cumsum(speed * np.cos(yaw), axis=1)
        y = table.y[row] + STEP_S * np.cumsum(speed * np.sin(yaw), axis=1)
        return self._first_touch(table, row, (x, y, yaw), t), self._stays_on_road(table, row, (x, y, yaw))

    def _first_touch(
        self, table: AgentTable, row: int, own: tuple[FloatArray, FloatArray, FloatArray], t: FloatArray
    ) -> FloatArray:
        """Time of the first touch (c,) of poses `own` (c, T) at times `t` (T,), infinite where there is none."""
        x, y, yaw = own
        ahead, left = to_body(table.x - table.x[row], table.y - table.y[row], table.yaw[row])
        half_length, half_width = 0.5 * (table.length + table.length[row]), 0.5 * (table.width + table.width[row])
        behind = (ahead < -half_length) & (np.abs(left) < half_width)
        reach = 2.0 * half_length + (table.speed + table.speed[row]) * self.config.horizon
        near = ~behind & (np.hypot(ahead, left) < reach)
        near[row] = False
        others = table.take(np.flatnonzero(near))
        if not len(others):
            return np.full(len(x), np.inf)
        grown = 2.0 * self.config.margin
        size = (others.length + grown, others.width + grown)
        mine = (table.length[row], table.width[row])
        touching = boxes_overlap(
            others.x - table.x[row], others.y - table.y[row], table.yaw[row], others.yaw, mine, size
        )
        braking = np.minimum(others.acceleration, 0.0)[:, None]
        going = np.where(braking < 0.0, -others.speed[:, None] / np.minimum(braking, -1e-3), np.inf)
        time = np.minimum(t, going)
        gone = others.speed[:, None] * time + 0.5 * braking * time**2
        other_x = others.x[:, None] + gone * np.cos(others.yaw)[:, None]
        other_y = others.y[:, None] + gone * np.sin(others.yaw)[:, None]
        hit = boxes_overlap(
            other_x[None] - x[:, None],
            other_y[None] - y[:, None],
            yaw[:, None],
            others.yaw[None, :, None],
            mine,
            (size[0][None, :, None], size[1][None, :, None]),
        )
        any_hit = np.asarray((hit & ~touching[None, :, None]).any(axis=1))
        return np.where(any_hit.any(axis=1), t[np.argmax(any_hit, axis=1)], np.inf)

    def _stays_on_road(self, table: AgentTable, row: int, own: tuple[FloatArray, FloatArray, FloatArray]) -> BoolArray:
        """(c,) whether both sides of the agent are on the road at `road_horizon`; an agent that is off it may be."""
        at = round(self.config.road_horizon / STEP_S) - 1
        x, y, yaw = (np.append(values[:, at], now[row]) for values, now in zip(own, _poses(table), strict=True))
        half = 0.5 * table.width[row]
        sides_x = np.concatenate([x - half * np.sin(yaw), x + half * np.sin(yaw)])
        sides_y = np.concatenate([y + half * np.cos(yaw), y - half * np.cos(yaw)])
        inside = np.asarray(self._lane_map.inside_road(sides_x, sides_y).reshape(2, -1).all(axis=0))
        return inside[:-1] | ~inside[-1]


def _poses(table: AgentTable) -> tuple[FloatArray, FloatArray, FloatArray]:
    return table.x, table.y, table.yaw
