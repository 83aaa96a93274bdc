"""Actors: agents that do what the changes of a scenario say, for a time, in place of what the policy wants."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from litsim_sim.core.geometry import arc_lengths, smooth_step, to_body
from litsim_sim.core.scene import STEP_S, AgentTable, ControlTable, FloatArray
from litsim_sim.scenario.changes import ENTRY_S, Brake, Cross, CutIn, Enter, Inattentive, LaneChange, Pace
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.setting import Setting
from litsim_sim.world.places import headways, places

REACH_S, REACH_MIN = 1.0, 4.0  # [s], [m] to the pursued point of a path
SPEED_GAIN = 1.0  # [1/s] acceleration per difference to the wanted speed
ACCELERATION_MAX, DECELERATION_MAX = 2.0, 4.0  # [m/s2] of an actor that does not brake by its change
CHANGE_LENGTH = 300.0  # [m] length of the path of a lane change


class Actors:
    """The actors of a run, or of several that are stepped together; :meth:`overrule` is called once a step."""

    def __init__(self, scenario: Setting) -> None:
        self._scenario = scenario
        self._actors = [
            _Actor(scenario, agent, act) for agent, act in scenario.actors if not isinstance(act, Inattentive)
        ]
        self._late = [_Late(agent, act) for agent, act in scenario.actors if isinstance(act, Inattentive)]

    def overrule(self, table: AgentTable, controls: ControlTable) -> ControlTable:
        """Returns `controls` with those of the agents that act at the step of `table` replaced, or added."""
        if table.step < self._scenario.history_steps:
            return controls
        for late in self._late:
            controls = late.delayed(table, controls)
        commands: dict[int, tuple[float, float]] = {}
        for actor in self._actors:
            row = table.row(actor.agent)
            if row >= 0 and not table.of_ego[row] and actor.acts_at(table, row):
                command = actor.command(table, row)
                if command is not None:
                    commands[row] = command
        if not commands:
            return controls
        rows = np.array(sorted(commands))
        acceleration, yaw_rate = np.array([commands[row] for row in rows.tolist()]).T
        acting = ControlTable.of_policy(table, rows, acceleration, yaw_rate)
        return ControlTable.merged(controls.take(~np.isin(controls.id, acting.id)), acting)


class _Late:
    """An agent whose driver reacts late."""

    def __init__(self, agent: int, act: Inattentive) -> None:
        self._agent, self._steps = agent, round(act.later_s / STEP_S)
        self._coming: deque[float] = deque()  # accelerations that have not taken effect yet [m/s2]

    def delayed(self, table: AgentTable, controls: ControlTable) -> ControlTable:
        """Returns `controls` with the acceleration of the agent from some steps ago; at first, what it has anyway."""
        (row,) = (controls.id == self._agent).nonzero()
        if not len(row):
            self._coming.clear()  # it is on its log
            return controls
        if not self._coming:
            self._coming.extend([float(table.acceleration[table.row(self._agent)])] * self._steps)
        acceleration = controls.acceleration.copy()
        self._coming.append(float(acceleration[row[0]]))
        acceleration[row[0]] = self._coming.popleft()
        return replace(controls, acceleration=acceleration)


class _Actor:
    """One agent and what it does."""

    def __init__(self, scenario: Setting, agent: int, act: Brake | LaneChange | Pace | Cross | Enter) -> None:
        log: Log = scenario.log
        self.agent, self._act, self._scenario = agent, act, scenario
        self._row = row = log.row(agent)
        self._begin = int(log.first_step[row]) + 1 if isinstance(act, Enter) else round(act.begin_s / STEP_S)
        self._steps = _duration_s(act) / STEP_S
        self._headway_s = None if isinstance(act, Pace | Enter) else act.headway_s  # that it still waits for
        valid = log.valid[row]
        self._logged = np.column_stack([log.x[row, valid], log.y[row, valid]])
        self._logged_speed = log.speed[row, valid]
        self._path: FloatArray | None = None if isinstance(act, LaneChange) else self._logged

    def acts_at(self, table: AgentTable, row: int) -> bool:
        """Returns whether it acts at the step of `table`, in whose `row` it is; once it is near enough it begins."""
        if self._headway_s is not None:
            if table.step < self._begin or not self._is_near(table, row, *self._headway_s):
                return False
            self._begin, self._headway_s = table.step, None
        return self._begin <= table.step < self._begin + self._steps

    def _is_near(self, table: AgentTable, row: int, least_s: float, greatest_s: float) -> bool:
        """Returns whether it is where its act concerns the ego of its scene, and the ego's headway is in bounds."""
        egos = (table.of_ego & (table.scene == table.scene[row])).nonzero()[0]
        if not len(egos):
            return False
        x, y, yaw = (getattr(table, name) for name in ("x", "y", "yaw"))
        place = places(x[row] - x[egos], y[row] - y[egos], yaw[row], yaw[egos])
        there = place.beside if isinstance(self._act, CutIn) else place.leading
        if isinstance(self._act, Cross):
            there = place.in_front
        (headway,) = headways(place.ahead, table.length[row], table.length[egos], table.speed[egos])
        return bool(there[0] and least_s <= headway <= greatest_s)

    def command(self, table: AgentTable, row: int) -> tuple[float, float] | None:
        """Returns acceleration [m/s2] and yaw rate [rad/s] of the agent in `row`; None where it cannot act."""
        x, y, yaw, speed = (float(getattr(table, name)[row]) for name in ("x", "y", "yaw", "speed"))
        if self._path is None and table.step == self._begin:
            self._path = self._lane_change(table, row)
        if self._path is None:
            return None
        if isinstance(self._act, Cross):
            return min((self._act.speed - speed) / STEP_S, ACCELERATION_MAX), 0.0
        nearest = int(np.hypot(self._path[:, 0] - x, self._path[:, 1] - y).argmin())
        target = _polyline_at(self._path[nearest:], max(REACH_MIN, REACH_S * speed))
        away = math.hypot(target[0] - x, target[1] - y)
        yaw_rate = 2.0 * speed * math.sin(math.atan2(target[1] - y, target[0] - x) - yaw) / max(away, 1.0)
        if isinstance(self._act, Brake):
            return -self._act.deceleration, yaw_rate
        if isinstance(self._act, LaneChange):  # by the time: it keeps up with the lane that it comes from
            step = min(max(table.step - int(self._scenario.log.first_step[self._row]), 0), len(self._logged_speed) - 1)
            wanted = float(self._logged_speed[step])
        else:
            wanted = float(self._logged_speed[nearest]) * (self._act.factor if isinstance(self._act, Pace) else 1.0)
        return min(max(SPEED_GAIN * (wanted - speed), -DECELERATION_MAX), ACCELERATION_MAX), yaw_rate

    def _lane_change(self, table: AgentTable, row: int) -> FloatArray | None:
        """Returns the path (m, 2) of the agent in `row` onto the lane beside its own; None without one."""
        assert isinstance(self._act, LaneChange)
        lane_map = self._scenario.lane_map
        pose = table.x[row], table.y[row], table.yaw[row]
        nearest = lane_map.nearest(*(np.array([value]) for value in pose))
        here, heading = lane_map.lanes[int(nearest.lane[0])], float(nearest.heading[0])
        to_left = here.left is not None
        if isinstance(self._act, CutIn):
            egos = (table.of_ego & (table.scene == table.scene[row])).nonzero()[0]
            if not len(egos):
                return None
            _, left = to_body(table.x[egos] - pose[0], table.y[egos] - pose[1], np.array(heading))
            to_left = bool(left[0] > 0.0)
        name = here.left if to_left else here.right
        if name is None:
            return None
        beside = lane_map.lanes[lane_map.row(name)]
        offset = 0.5 * (here.width + beside.width) * (1.0 if to_left else -1.0)
        centre = lane_map.path_from(
            lane_map.row(name), float(nearest.s[0]) * beside.length / here.length, CHANGE_LENGTH
        )
        along = arc_lengths(centre)
        marks = np.arange(0.0, along[-1], 1.0)
        points = np.column_stack([np.interp(marks, along, centre[:, axis]) for axis in (0, 1)])
        direction = np.gradient(points, axis=0)
        normal = np.column_stack([-direction[:, 1], direction[:, 0]]) / np.hypot(*direction.T)[:, None]
        u = np.clip(marks / (self._act.duration_s * max(float(table.speed[row]), 3.0)), 0.0, 1.0)
        still = (float(nearest.d[0]) - offset) * (1.0 - smooth_step(u))  # [m] left of the new lane's centre
        return np.asarray(points + still[:, None] * normal, np.float64)


def _duration_s(act: Brake | LaneChange | Pace | Cross | Enter) -> float:
    """Returns the time for which an agent acts [s]."""
    if isinstance(act, Enter | Cross):
        return ENTRY_S if isinstance(act, Enter) else math.inf
    return act.duration_s * (2.0 if isinstance(act, LaneChange) else 1.0)


def _polyline_at(points: FloatArray, s: float) -> FloatArray:
    """Returns the point (2,) at arc length `s` [m] of a polyline (m, 2), prolonged straight beyond its end."""
    along = arc_lengths(points)
    if s <= along[-1]:
        return np.array([np.interp(s, along, points[:, 0]), np.interp(s, along, points[:, 1])])
    moving = (along < along[-1] - 1.0).nonzero()[0]
    direction = points[-1] - points[moving[-1] if len(moving) else 0]
    length = np.hypot(*direction)
    return points[-1] + (s - along[-1]) * (direction / length if length > 0.0 else direction)
