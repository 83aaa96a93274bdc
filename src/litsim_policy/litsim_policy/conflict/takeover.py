"""The life cycle of a takeover: LOG, HELD by the policy, HANDBACK to the log, RELEASED."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from litsim_policy.conflict.detection import Conflict, ConflictConfig, ConflictDetector, PredictedMotion
from litsim_policy.motion.car_following import along_path
from litsim_policy.motion.reference_path import ReferencePath, logged_path, window_of
from litsim_policy.motion.route import Router
from litsim_predictor.forecast import Forecast
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import (
    Angle,
    Duration,
    Length,
    NonNegative,
    Positive,
    Speed,
    Steps,
    Whole,
    configuration,
)
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, Controller, IntArray
from litsim_sim.core.takeover import PathSource, Pose, Takeover, TakeoverReason, TakeoverState, TakeoverTable
from litsim_sim.scenario.scenario import Scenario


@configuration
class TakeoverConfig:
    """When an agent is taken over, handed back and released.

    Attributes:
        confirm_steps: steps in a row that predict a conflict before it is believed.
        urgent_time: to a conflict within which it is believed at once.
        held_steps_min: steps for which an agent is held at least.
        clear_steps: steps in a row without conflict before the hand-back begins, once the goal is passed; twice as
            many before.
        iterations_max: bound on the iterations of detection within a step.
        release_position: residual within which the hand-back is over.
        release_speed: residual likewise.
        release_yaw: residual likewise.
        handback: how an agent comes back: catch_up, to where its log has it at the time; or time_shift, to where its
            log was nearest to it, the log being replayed with that lag from then on.
    """

    confirm_steps: Positive[Steps] = 3
    urgent_time: NonNegative[Duration] = 1.0
    held_steps_min: NonNegative[Steps] = 5
    clear_steps: NonNegative[Steps] = 5
    iterations_max: Positive[Whole] = 10
    release_position: NonNegative[Length] = 0.5
    release_speed: NonNegative[Speed] = 1.0
    release_yaw: NonNegative[Angle] = 0.1
    handback: Literal["catch_up", "time_shift"] = "time_shift"


@dataclass
class _Record:
    """What is remembered of an agent off its log.

    Attributes:
        path: to its goal and on, which it follows while it is HELD.
        logged: where it went in the recording, which it follows back.
        goal_s: arc length of the goal on `path` [m].
        clear: steps in a row without conflict.
    """

    takeover: Takeover
    path: ReferencePath
    logged: ReferencePath
    goal_s: float
    clear: int = 0


@dataclass
class TakeoverManager:
    """The conflict stage: :meth:`update` is called once a step, in order.

    Attributes:
        scenario: of the run.
        conflict_config, config: parameters.
    """

    scenario: Scenario
    conflict_config: ConflictConfig
    config: TakeoverConfig = field(default_factory=TakeoverConfig)

    def __post_init__(self) -> None:
        log = self.scenario.log
        self._detector = ConflictDetector(log, self.scenario.roi_m, self.conflict_config)
        self._router = Router(self.scenario.lane_map)
        self._records: dict[int, _Record] = {}
        self._suspected: dict[int, int] = {}
        self._lag: IntArray = np.zeros(len(log.ids), np.int64)  # steps by which the replay of each log lags, or would

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:
        """Who is off its log at this step, and why."""
        if table.step < self.scenario.history_steps:
            return TakeoverTable(table.step)
        self._records = {agent: r for agent, r in self._records.items() if table.row(agent) >= 0}
        for row in np.flatnonzero(table.controller == Controller.POLICY):
            if int(table.id[row]) not in self._records:
                self._adopt(table, int(row))
        self._choose_lags(table)
        lag = self._lag[np.searchsorted(self.scenario.log.ids, table.id)]
        logged = self._detector.logged_future(table, lag)
        lagged = (lag > 0) & (table.controller == Controller.LOG)
        expected = self._detector.forecast_future(table, forecast).replaced(lagged, logged)
        known = set(self._records)
        iterations, converged = self._take_over(table, logged, expected, lagged)
        self._review(table, logged, expected, known, lagged)
        takeovers = tuple(self._report(table, self._records[agent]) for agent in sorted(self._records))
        self._records = {a: r for a, r in self._records.items() if r.takeover.state != TakeoverState.RELEASED}
        return TakeoverTable(table.step, takeovers, iterations, converged)

    def _choose_lags(self, table: AgentTable) -> None:
        """Choose for each agent off its log the lag of the log that it would go back to at this step."""
        log = self.scenario.log
        for agent in self._records:
            row, log_row = table.row(agent), log.row(agent)
            shifts = self.config.handback == "time_shift"
            self._lag[log_row] = log.lag(log_row, table.step, table.x[row], table.y[row]) if shifts else 0

    def _off_log(self, table: AgentTable) -> BoolArray:
        """(n,) the ego, and those that are driven."""
        off = table.id == self.scenario.ego_id
        return off | np.isin(table.id, np.array(sorted(self._records), np.int64))

    def _take_over(
        self, table: AgentTable, logged: PredictedMotion, expected: PredictedMotion, lagged: BoolArray
    ) -> tuple[int, bool]:
        """Add the agents whose conflict is confirmed; returns the iterations needed and whether nothing was left.

        Each iteration looks at the agents that the one before has put off their logs; the first, at all that were.
        """
        suspected: dict[int, int] = {}
        fresh, iterations = self._off_log(table) | lagged, 0
        while fresh.any() and iterations < self.config.iterations_max:
            iterations += 1
            before = self._off_log(table)
            for conflict in self._detector.detect(table, ~before, fresh, logged, expected):
                seen = self._suspected.get(conflict.agent, 0) + 1
                suspected[conflict.agent] = seen
                if seen >= self.config.confirm_steps or conflict.time_to_conflict <= self.config.urgent_time:
                    self._open(table, conflict)
            fresh = self._off_log(table) & ~before
        self._suspected = suspected
        return iterations, not fresh.any()

    def _open(self, table: AgentTable, conflict: Conflict) -> None:
        """Take over the agent of `conflict`, towards the crossing point."""
        row = table.row(conflict.agent)
        logged = logged_path(self.scenario.log, self.scenario.lane_map, conflict.agent)
        pose = np.array([table.x[row], table.y[row], table.yaw[row]])
        path = self._router.path(pose, float(table.speed[row]), conflict.pose)
        if path is None:
            self._record(table, conflict, TakeoverReason.CONFLICT, logged, logged)
        else:
            self._record(table, conflict, TakeoverReason.CONFLICT, path.followed_by(logged), logged)

    def _adopt(self, table: AgentTable, row: int) -> None:
        """Take over an agent that entered late: its log began where the road was not free."""
        off = np.flatnonzero(self._off_log(table) & (np.arange(len(table)) != row))
        nearest = (
            off[np.argmin(np.hypot(table.x[off] - table.x[row], table.y[off] - table.y[row]))] if len(off) else row
        )
        pose = np.array([table.x[row], table.y[row], table.yaw[row]])
        conflict = Conflict(int(table.id[row]), int(table.id[nearest]), 0.0, pose, 1.0)
        logged = logged_path(self.scenario.log, self.scenario.lane_map, conflict.agent)
        self._record(table, conflict, TakeoverReason.BLOCKED_ENTRY, logged, logged)

    def _record(
        self, table: AgentTable, conflict: Conflict, reason: TakeoverReason, path: ReferencePath, logged: ReferencePath
    ) -> None:
        goal_s, _ = path.project(conflict.pose[:1], conflict.pose[1:2])
        pose: Pose = tuple(conflict.pose.tolist())
        takeover = Takeover(
            agent=conflict.agent,
            opponent=conflict.opponent,
            state=TakeoverState.HELD,
            reason=reason,
            detected_step=table.step,
            time_to_conflict=conflict.time_to_conflict,
            overlap_probability=conflict.overlap_probability,
            conflict_pose=pose,
            goal_pose=pose,
            reference_path=path.points,
            log_collision_predicted=True,
            residual_position=0.0,
            residual_speed=0.0,
            path_source=PathSource.LOGGED if path is logged else PathSource.ROUTE,
        )
        self._records[conflict.agent] = _Record(takeover, path, logged, float(goal_s[0]))

    def _review(
        self, table: AgentTable, logged: PredictedMotion, expected: PredictedMotion, known: set[int], lagged: BoolArray
    ) -> None:
        """Move the agents that were off their log before this step through their life cycle."""
        if not known:
            return
        on_log = self.scenario.log.table(table.step, self._lag)
        mine = np.isin(table.id, sorted(known))
        in_conflict = self._detector.still_in_conflict(table, mine, self._off_log(table) | lagged, logged, expected)
        for agent in sorted(known):
            record, row, log_row = self._records[agent], table.row(agent), on_log.row(agent)
            blocked = bool(in_conflict[row])
            if log_row < 0 or blocked or self._obstructed(table, row, on_log, log_row, record.logged):
                record.clear = 0
                state = TakeoverState.HELD
            else:
                record.clear += 1
                state = self._next_state(table, row, on_log, log_row, record)
            if state == TakeoverState.HANDBACK and record.path is not record.logged:
                record.path = record.logged
                goal = np.array(record.takeover.goal_pose)
                record.goal_s = float(record.path.project(goal[:1], goal[1:2])[0][0])
                record.takeover = replace(record.takeover, path_source=PathSource.LOGGED)
            record.takeover = replace(record.takeover, state=state, log_collision_predicted=blocked)

    def _next_state(
        self, table: AgentTable, row: int, on_log: AgentTable, log_row: int, record: _Record
    ) -> TakeoverState:
        """State of an agent that is free of conflict."""
        if record.takeover.state == TakeoverState.HELD:
            s, _ = record.path.project(table.x[row : row + 1], table.y[row : row + 1])
            needed = self.config.clear_steps * (1 if s[0] >= record.goal_s else 2)
            held = table.step - record.takeover.detected_step
            return (
                TakeoverState.HANDBACK
                if record.clear >= needed and held >= self.config.held_steps_min
                else TakeoverState.HELD
            )
        position, speed, yaw = _residual(table, row, on_log, log_row)
        within = position <= self.config.release_position and abs(speed) <= self.config.release_speed
        return TakeoverState.RELEASED if within and abs(yaw) <= self.config.release_yaw else TakeoverState.HANDBACK

    def _obstructed(self, table: AgentTable, row: int, on_log: AgentTable, log_row: int, path: ReferencePath) -> bool:
        """Whether somebody stands between an agent and its place in the log."""
        s, _ = path.project(np.array([table.x[row], on_log.x[log_row]]), np.array([table.y[row], on_log.y[log_row]]))
        view = along_path(path, table, row)
        between = view.ahead & view.in_path & (view.gap < s[1] - s[0])
        return bool(between.any())

    def _report(self, table: AgentTable, record: _Record) -> Takeover:
        """The takeover as it is published: path from the agent on, residuals of this step.

        Residuals are measured against the log that the agent goes back to, with its lag, as the release measures them.
        """
        row = table.row(record.takeover.agent)
        on_log = self.scenario.log.table(table.step, self._lag)
        log_row = on_log.row(record.takeover.agent)
        position, speed, _ = _residual(table, row, on_log, log_row) if log_row >= 0 else (-1.0, 0.0, 0.0)
        lag = int(self._lag[self.scenario.log.row(record.takeover.agent)])
        s, _ = record.path.project(table.x[row : row + 1], table.y[row : row + 1])
        points = record.path.points[window_of(record.path.s, float(s[0]))]
        return replace(
            record.takeover,
            reference_path=points,
            residual_position=position,
            residual_speed=speed,
            time_shift=lag * STEP_S,
        )


def _residual(table: AgentTable, row: int, on_log: AgentTable, log_row: int) -> tuple[float, float, float]:
    """Distance [m], speed [m/s] and heading [rad] of an agent relative to its log."""
    position = np.hypot(table.x[row] - on_log.x[log_row], table.y[row] - on_log.y[log_row])
    yaw = wrap_angle(table.yaw[row : row + 1] - on_log.yaw[log_row : log_row + 1])
    return float(position), float(table.speed[row] - on_log.speed[log_row]), float(yaw[0])


def conflict_stage(read: ParameterReader) -> Callable[[Scenario], TakeoverManager]:
    """Read the parameters of the conflict stage; what is returned builds its core once the run is known."""
    conflict, takeover = read(ConflictConfig()), read(TakeoverConfig())
    return lambda scenario: TakeoverManager(scenario, conflict, takeover)
