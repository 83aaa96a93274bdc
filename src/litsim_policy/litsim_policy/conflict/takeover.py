"""The life cycle of a takeover: LOG, HELD by the policy, HANDBACK to the log, RELEASED."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detection import Conflict, ConflictDetector
from litsim_policy.conflict.hindsight import Hindsight
from litsim_policy.conflict.intended import Intents
from litsim_policy.conflict.life_cycle import RELEASED, Excuse, Residuals, review
from litsim_policy.conflict.off_log import OffLog
from litsim_policy.conflict.passing import Passing, PassingConfig
from litsim_policy.conflict.scene import ConflictScene
from litsim_policy.motion.reference_path import ReferencePath, logged_path
from litsim_policy.motion.route import Router
from litsim_predictor.forecast import Forecast
from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.quantities import (
    Angle,
    Duration,
    Flag,
    Length,
    NonNegative,
    Positive,
    Speed,
    Steps,
    Whole,
    configuration,
)
from litsim_sim.core.scene import AgentTable, BoolArray, IntArray
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverTable
from litsim_sim.scenario.setting import Setting


@configuration
class TakeoverConfig:
    """When an agent is taken over, handed back and released.

    Attributes:
        confirm_steps: steps in a row that must predict a conflict before a takeover.
        urgent_time: time to a conflict within which the takeover is immediate.
        held_steps_min: least number of steps for which an agent is held.
        clear_steps: steps in a row without conflict before the hand-back begins, once the goal is passed; twice as
            many before.
        iterations_max: bound on the iterations of detection within a step.
        release_position: largest residual with which the hand-back ends.
        release_speed: residual likewise.
        release_yaw: residual likewise.
        handback: catch_up, to the present position of the log; or time_shift, to the position of the log that is
            nearest to the agent, after which the log is replayed with that lag.
        passing: whether agents behind a permanently slow one pass.
        lane_change: conditions and execution of passing.
    """

    confirm_steps: Positive[Steps] = 3
    urgent_time: NonNegative[Duration] = 1.0
    held_steps_min: NonNegative[Steps] = 5
    clear_steps: NonNegative[Steps] = 5
    iterations_max: Positive[Whole] = 10
    release_position: NonNegative[Length] = 0.5
    release_speed: NonNegative[Speed] = 1.5
    release_yaw: NonNegative[Angle] = 0.1
    handback: Literal["catch_up", "time_shift"] = "time_shift"
    passing: Flag = True
    lane_change: PassingConfig = field(default_factory=PassingConfig)


@dataclass
class TakeoverManager:
    """The conflict stage: :meth:`update` is called once a step, in order.

    Attributes:
        scenario: of the run; joined scenes do not influence each other.
        conflict_config, config: parameters.
        iterations, converged: (scenes,) of the last update, as in :class:`TakeoverTable`.
    """

    scenario: Setting
    conflict_config: ConflictConfig
    config: TakeoverConfig = field(default_factory=TakeoverConfig)

    def __post_init__(self) -> None:
        log = self.scenario.log
        self._overlaps = self.scenario.log_overlaps
        roi_m = self.conflict_config.roi_m or self.scenario.roi_m
        self._detector = ConflictDetector(log, roi_m, self.conflict_config, self._overlaps)
        config = self.conflict_config
        happened = Path(config.happened) if config.happened else None
        self._hindsight = None if happened is None else Hindsight(self.scenario, happened, config.horizon)
        self._router = Router(self.scenario.lane_map)
        self._passing: Passing | None = None
        if self.config.passing:
            self._passing = Passing(self.scenario.lane_map, log, self._router, self.config.lane_change)
        self._ego_ids = self.scenario.ego_ids
        self.iterations: IntArray = np.zeros(len(self._ego_ids), np.int64)
        self.converged: BoolArray = np.ones(len(self._ego_ids), np.bool_)
        self._off = OffLog.empty()
        self._logged: dict[int, ReferencePath] = {}
        self._suspected: dict[int, int] = {}
        self._lag: IntArray = np.zeros(len(log.ids), np.int64)  # steps by which each log lags, or would after a return

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:
        """The agents off their logs at this step, and why."""
        if table.step < self.scenario.history_steps:
            return TakeoverTable(table.step)
        log = self.scenario.log
        self._off = self._off.take(table.rows(self._off.agent) >= 0)
        was_off = self._is_off(table)
        entered = (table.of_policy & ~was_off).nonzero()[0]
        if len(entered):
            self._adopt(table, entered, was_off)
            was_off = self._is_off(table)
        self._choose_lags(table)
        lag, walking = self._lag[log.ids.searchsorted(table.id)], table.obstacle
        lagged = (lag > 0) & ~table.off_log
        scene = ConflictScene(self._detector, table, forecast, lag, lagged | walking, lambda: self._intents(table))
        is_off = self._take_over(table, scene, was_off, lagged, walking)
        rows, log_rows = self._rows(table, self._off)
        lags = lag[rows]
        residuals = Residuals.of(log, log_rows, lags, table, rows)
        self._review(table, scene, was_off[rows], rows, lags, residuals, is_off | lagged | walking)
        if self._passing is not None and len(self._off):
            self._passing.look_for_lanes(table, self._off, rows, lags)
        takeovers = self._off.report(table.x[rows], table.y[rows], residuals.reported, lags)
        self._off = self._off.take(self._off.state != RELEASED)
        return TakeoverTable(table.step, takeovers, int(self.iterations.max()), bool(self.converged.all()))

    def _intents(self, table: AgentTable) -> Intents:
        """The agents under control so far at this step, and their paths."""
        off = self._off
        return Intents(table.rows(off.agent), off.paths, off.detected_step == table.step)

    def _choose_lags(self, table: AgentTable) -> None:
        """Choose the lag with which each agent off its log would return to its log at this step."""
        rows, log_rows = self._rows(table, self._off)
        if self.config.handback == "time_shift":
            self._lag[log_rows] = self.scenario.log.lags(log_rows, table.step, table.x[rows], table.y[rows])
        else:
            self._lag[log_rows] = 0

    def _unneeded(self, table: AgentTable, rows: IntArray) -> BoolArray:
        """Agents whose logs are over, without the ego or an agent off its log whose own log continues nearby.

        Args:
            table: all agents.
            rows: (r,) in `table` of all agents off their logs.

        Returns:
            mask (r,); a log that lasts until the end of the recording does not count as over.
        """
        log = self.scenario.log
        log_rows = log.ids.searchsorted(table.id[rows])
        last = log.last_step[log_rows]
        over = (table.step - self._lag[log_rows] >= last) & (last < self.scenario.last_logged[table.scene[rows]])
        if over.any():
            others = self._is_off(table)
            others[rows[over]] = False
            over &= ~self._detector.around(table, others)[rows]
        return over

    def _excuse(self, table: AgentTable) -> Excuse:
        """The excuse for pairs of background agents that overlap in the log at their places."""

        def excuse(row: int, other: int) -> bool:
            if table.of_ego[other]:
                return False
            a, b = self.scenario.log.ids.searchsorted(table.id[[row, other]]).tolist()
            return self._overlaps.meets(a, b, table.step - self._lag[a], table.x[other], table.y[other])

        return excuse

    def _rows(self, table: AgentTable, off: OffLog) -> tuple[IntArray, IntArray]:
        """Rows (r,) of agents off their logs in `table`, and in the log."""
        return table.rows(off.agent), self.scenario.log.ids.searchsorted(off.agent)

    def _is_off(self, table: AgentTable) -> BoolArray:
        """Mask (n,) of the ego and of driven agents."""
        off = table.mask(self._ego_ids)
        off[table.rows(self._off.agent)] = True
        return off

    def _take_over(
        self, table: AgentTable, scene: ConflictScene, was_off: BoolArray, lagged: BoolArray, walking: BoolArray
    ) -> BoolArray:
        """Take over agents with confirmed conflicts; record the number of iterations and whether they converged.

        The first iteration compares with all agents off their logs or on lagged ones, each further one with those that
        the previous one has taken over. Pedestrians and cyclists are never taken over; agents on lagged logs must yield
        to them.

        Args:
            table: all agents.
            scene: of the step.
            was_off: mask (n,) of agents off their logs, the ego included.
            lagged: mask (n,) of agents that follow a lagged log.
            walking: mask (n,) of pedestrians and cyclists.

        Returns:
            mask (n,) of agents off their logs now.
        """
        suspected: dict[int, int] = {}
        off, fresh, done = was_off, was_off | lagged, 0
        barred = walking
        if self.conflict_config.region == "ego":
            barred = walking | ~self._detector.around(table, table.mask(self._ego_ids))
        self.iterations = np.zeros(len(self._ego_ids), np.int64)
        while fresh.any() and done < self.config.iterations_max:
            done += 1
            self.iterations[table.scene[fresh]] = done
            before, off = off, off.copy()
            candidates = ~before & ~barred
            known = self._hindsight
            found = scene.detect(candidates, fresh) if known is None else known.detect(table, candidates)
            if done == 1 and lagged.any():
                late = lagged & ~before & ~barred
                found = _soonest(found, scene.detect_behind(late, ~before & ~lagged))
                if walking.any():
                    found = _soonest(found, scene.detect(lagged & ~before, walking))
            for conflict in found:
                seen = self._suspected.get(conflict.agent, 0) + 1
                suspected[conflict.agent] = seen
                soon = conflict.urgent or conflict.time_to_conflict <= self.config.urgent_time
                if soon or seen >= self.config.confirm_steps:
                    self._open(table, conflict)
                    off[table.row(conflict.agent)] = True
            fresh = off & ~before
        self._suspected = suspected
        self.converged = np.ones(len(self._ego_ids), np.bool_)
        self.converged[table.scene[fresh]] = False
        return off

    def _open(self, table: AgentTable, conflict: Conflict) -> None:
        """Take over the agent of `conflict`, towards the crossing point."""
        row, logged = table.row(conflict.agent), self._logged_path(conflict.agent)
        pose = np.array([table.x[row], table.y[row], table.yaw[row]])
        route = self._router.path(pose, float(table.speed[row]), conflict.pose)
        path = logged if route is None else route.followed_by(logged)
        source = PathSource.LOGGED if route is None else PathSource.ROUTE
        opened = OffLog.opened(conflict, table.step, TakeoverReason.CONFLICT, path, source, logged)
        self._off = self._off.joined(opened)

    def _adopt(self, table: AgentTable, rows: IntArray, was_off: BoolArray) -> None:
        """Take over agents that entered late, because their logs began where the road was not free.

        The opponent of each is the nearest agent off its log, including those just adopted.

        Args:
            table: all agents.
            rows: (k,) of the agents.
            was_off: mask (n,) of agents that are already off their logs.
        """
        off, (begin, end), opened = was_off.copy(), within_scenes(table.scene, rows), []
        for row, first, last in zip(rows.tolist(), begin.tolist(), end.tolist(), strict=True):
            others = first + off[first:last].nonzero()[0]
            apart = np.hypot(table.x[others] - table.x[row], table.y[others] - table.y[row])
            nearest = others[apart.argmin()] if len(others) else row
            pose = np.array([table.x[row], table.y[row], table.yaw[row]])
            conflict = Conflict(int(table.id[row]), int(table.id[nearest]), 0.0, pose, 1.0)
            logged, reason = self._logged_path(conflict.agent), TakeoverReason.BLOCKED_ENTRY
            opened.append(OffLog.opened(conflict, table.step, reason, logged, PathSource.LOGGED, logged))
            off[row] = True
        self._off = self._off.joined(*opened)

    def _logged_path(self, agent: int) -> ReferencePath:
        """The recorded path of `agent`."""
        if agent not in self._logged:
            self._logged[agent] = logged_path(self.scenario.log, self.scenario.lane_map, agent)
        return self._logged[agent]

    def _review(
        self,
        table: AgentTable,
        scene: ConflictScene,
        known: BoolArray,
        rows: IntArray,
        lags: IntArray,
        residuals: Residuals,
        off_log: BoolArray,
    ) -> None:
        """Move agents that were off their logs before this step through their life cycle.

        Args:
            table: all agents.
            scene: of the step.
            known: mask (r,) of these agents.
            rows: (r,) in `table` of all agents off their logs.
            lags: (r,) steps by which their logs lag.
            residuals: of these.
            off_log: mask (n,) of the agents that may be in conflict with these: off their logs, on lagged logs, or
                walking.
        """
        if not known.any():
            return
        off, mine = self._off.take(known), np.zeros(len(table), np.bool_)
        mine[rows[known]] = True
        in_conflict = scene.still_in_conflict(mine, off_log)
        excuse, unneeded = self._excuse(table), self._unneeded(table, rows)[known]
        mine_now, residuals = rows[known], residuals.take(known)
        if self._passing is not None:
            returns = self._passing.may_return(table, off, mine_now, lags[known], residuals)
            residuals = replace(residuals, known=residuals.known & returns)
        review(self.config, off, table, mine_now, residuals, in_conflict[mine_now], excuse, unneeded)
        if off is not self._off:
            self._off = off.joined(self._off.take(~known))


def _soonest(some: list[Conflict], more: list[Conflict]) -> list[Conflict]:
    """The first conflict of each agent in both lists, in the order of time."""
    found: dict[int, Conflict] = {}
    for conflict in sorted((*some, *more), key=lambda each: each.time_to_conflict):
        found.setdefault(conflict.agent, conflict)
    return list(found.values())
