"""The life cycle of a takeover: LOG, HELD by the policy, HANDBACK to the log, RELEASED."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numba import types

from litsim_policy.conflict.config import ConflictConfig, TakeoverConfig
from litsim_policy.conflict.detector import Conflict, ConflictDetector, soonest
from litsim_policy.conflict.diverged import HANDBACK, HELD, RELEASED, DivergedAgents, Residuals
from litsim_policy.conflict.futures import Futures, PlannedPaths
from litsim_policy.conflict.hindsight import Hindsight
from litsim_policy.conflict.passing import Passing
from litsim_policy.motion.along_path import along_paths
from litsim_policy.motion.reference_path import ReferencePath, logged_path
from litsim_policy.motion.route import Router
from litsim_predictor.forecast import Forecast
from litsim_sim.core.nearby import around
from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.scene import AgentTable, BoolArray, ByteArray, FloatArray, IntArray
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverTable
from litsim_sim.kernels.compiled import BOOLS, FLOATS, INTS, OUT_BYTES, OUT_INTS, float64, int64, kernel, void
from litsim_sim.scenario.setting import Setting

Exemption = Callable[[int, int], bool]
"""Whether the agent in the first row of a table, on the way to its place in the log, overlaps the second there, too."""

OBSTACLE_SIGHT = 30.0  # [m] range, beyond the distance to the place in the log, of agents that may block the way


@dataclass
class TakeoverManager:
    """The conflict stage: :meth:`update` is called once a step, in order.

    Attributes:
        scenario: of the run; batched scenarios do not influence each other.
        conflict_config, config: parameters.
        iterations, converged: (scenes,) of the last update, as in :class:`TakeoverTable`.
    """

    scenario: Setting
    conflict_config: ConflictConfig
    config: TakeoverConfig = field(default_factory=TakeoverConfig)

    def __post_init__(self) -> None:
        scenario, config = self.scenario, self.conflict_config
        self._roi_m = config.roi_m or scenario.roi_m
        self._detector = ConflictDetector(scenario.log, self._roi_m, config, scenario.log_overlaps)
        self._hindsight = Hindsight(scenario, Path(config.happened), config.horizon) if config.happened else None
        self._router, self._logged_paths = Router(scenario.lane_map), dict[int, ReferencePath]()
        self._passing: Passing | None = None
        if self.config.passing:
            self._passing = Passing(scenario.lane_map, scenario.log, self._router, self.config.lane_change)
        self.iterations: IntArray = np.zeros(len(scenario.ego_ids), np.int64)
        self.converged: BoolArray = np.ones(len(scenario.ego_ids), np.bool_)
        self._diverged = DivergedAgents.empty()
        self._suspected: dict[int, int] = {}  # steps in a row for which each agent has been in conflict
        self._lag: IntArray = np.zeros(len(scenario.log.ids), np.int64)  # of each log, or that after a return to it

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:
        """The agents off their logs at this step, and why."""
        if table.step < self.scenario.history_steps:
            return TakeoverTable(table.step)
        log = self.scenario.log
        self._diverged = self._diverged.kept(table.rows(self._diverged.agent) >= 0)
        before = self._adopt_late_entries(table, self._is_diverged(table))
        lag = self._choose_lags(table)
        lagged = (lag > 0) & ~table.off_log
        planned, keep_to_log = lambda: self._planned_paths(table), lagged | table.obstacle
        futures = Futures(log, self.conflict_config, table, forecast, lag, keep_to_log, planned)
        now = self._take_over(futures, before, lagged)
        rows = table.rows(self._diverged.agent)
        residuals = Residuals.of(log, log.ids.searchsorted(self._diverged.agent), lag[rows], table, rows)
        self._review(futures, before[rows], rows, lag[rows], residuals, now | keep_to_log)
        if self._passing is not None and len(self._diverged):
            self._passing.change_lanes(table, self._diverged, rows, lag[rows])
        takeovers = self._diverged.report(table.x[rows], table.y[rows], residuals.reported, lag[rows])
        self._diverged = self._diverged.kept(self._diverged.state != RELEASED)
        return TakeoverTable(table.step, takeovers, int(self.iterations.max()), bool(self.converged.all()))

    def _is_diverged(self, table: AgentTable) -> BoolArray:
        """Mask (n,) of the ego and of driven agents."""
        diverged = table.mask(self.scenario.ego_ids)
        diverged[table.rows(self._diverged.agent)] = True
        return diverged

    def _choose_lags(self, table: AgentTable) -> IntArray:
        """Steps (n,) by which the log of each agent lags, or would after a return to it at this step."""
        log, agents = self.scenario.log, self._diverged.agent
        rows, log_rows = table.rows(agents), log.ids.searchsorted(agents)
        self._lag[log_rows] = 0
        if self.config.handback == "time_shift":
            self._lag[log_rows] = log.lags(log_rows, table.step, table.x[rows], table.y[rows])
        return self._lag[log.ids.searchsorted(table.id)]

    def _planned_paths(self, table: AgentTable) -> PlannedPaths:
        """The agents under control so far at this step, and their paths."""
        diverged = self._diverged
        return PlannedPaths(table.rows(diverged.agent), diverged.paths, diverged.detected_step == table.step)

    def _take_over(self, futures: Futures, before: BoolArray, lagged: BoolArray) -> BoolArray:
        """Take over agents with confirmed conflicts; record the number of iterations and whether they converged.

        The first iteration compares with all agents off their logs or on lagged ones, each further one with those that
        the previous one has taken over. Pedestrians and cyclists are never taken over.

        Args:
            futures: of the agents of the step.
            before: mask (n,) of agents off their logs, the ego included.
            lagged: mask (n,) of agents that follow a lagged log.

        Returns:
            mask (n,) of agents off their logs now.
        """
        table, suspected = futures.table, dict[int, int]()
        barred = table.obstacle
        if self.conflict_config.region == "ego":
            barred = barred | ~around(table, table.mask(self.scenario.ego_ids), self._roi_m)
        self.iterations, done = np.zeros(len(self.iterations), np.int64), 0
        diverged, fresh = before, before | lagged
        while fresh.any() and done < self.config.iterations_max:
            done += 1
            self.iterations[table.scene[fresh]] = done
            known, diverged = diverged, diverged.copy()
            conflicts = self._predict(futures, ~known & ~barred, fresh)
            if done == 1 and lagged.any():
                conflicts = soonest(conflicts, *self._predict_unknown_to_logs(futures, before, lagged, barred))
            for conflict in conflicts:
                seen = suspected[conflict.agent] = self._suspected.get(conflict.agent, 0) + 1
                soon = conflict.urgent or conflict.time_to_conflict <= self.config.urgent_time
                if soon or seen >= self.config.confirm_steps:
                    self._open(table, conflict)
                    diverged[table.row(conflict.agent)] = True
            fresh = diverged & ~known
        self._suspected = suspected
        self.converged = np.ones(len(self.converged), np.bool_)
        self.converged[table.scene[fresh]] = False
        return diverged

    def _predict(self, futures: Futures, on_log: BoolArray, diverged: BoolArray) -> list[Conflict]:
        """Conflicts of agents `on_log` with agents `diverged` (masks (n,)), by prediction or by hindsight."""
        if self._hindsight is not None:
            return self._hindsight.recorded_conflicts(futures.table, on_log)
        return self._detector.conflicts(futures, on_log, diverged)

    def _predict_unknown_to_logs(
        self, futures: Futures, diverged: BoolArray, lagged: BoolArray, barred: BoolArray
    ) -> tuple[list[Conflict], list[Conflict]]:
        """Conflicts of agents on `lagged` logs with agents on theirs: their leaders, and pedestrians and cyclists."""
        mine, walking = lagged & ~diverged, futures.table.obstacle
        leaders = self._detector.conflicts_with_leaders(futures, mine & ~barred, ~diverged & ~lagged)
        return leaders, self._detector.conflicts(futures, mine, walking) if walking.any() else []

    def _open(self, table: AgentTable, conflict: Conflict) -> None:
        """Take over the agent of `conflict`, towards the crossing point."""
        row, logged = table.row(conflict.agent), self._logged_path(conflict.agent)
        pose = np.array([table.x[row], table.y[row], table.yaw[row]])
        route = self._router.path(pose, float(table.speed[row]), conflict.pose)
        path = logged if route is None else route.followed_by(logged)
        source = PathSource.LOGGED if route is None else PathSource.ROUTE
        opened = DivergedAgents.opened(conflict, table.step, TakeoverReason.CONFLICT, path, source, logged)
        self._diverged = self._diverged.joined(opened)

    def _adopt_late_entries(self, table: AgentTable, diverged: BoolArray) -> BoolArray:
        """Take over agents that entered late, because their logs began where the road was not free.

        The opponent of each is the nearest agent off its log, including those just adopted.

        Args:
            table: all agents.
            diverged: mask (n,) of agents off their logs so far, the ego included.

        Returns:
            mask (n,) of agents off their logs now.
        """
        rows, opened = (table.of_policy & ~diverged).nonzero()[0], []
        if not len(rows):
            return diverged
        diverged = diverged.copy()
        begin, end = within_scenes(table.scene, rows)
        for row, first, last in zip(rows.tolist(), begin.tolist(), end.tolist(), strict=True):
            others = first + diverged[first:last].nonzero()[0]
            apart = np.hypot(table.x[others] - table.x[row], table.y[others] - table.y[row])
            nearest = others[apart.argmin()] if len(others) else row
            pose = np.array([table.x[row], table.y[row], table.yaw[row]])
            conflict = Conflict(int(table.id[row]), int(table.id[nearest]), 0.0, pose, 1.0)
            logged, reason = self._logged_path(conflict.agent), TakeoverReason.BLOCKED_ENTRY
            opened.append(DivergedAgents.opened(conflict, table.step, reason, logged, PathSource.LOGGED, logged))
            diverged[row] = True
        self._diverged = self._diverged.joined(*opened)
        return diverged

    def _logged_path(self, agent: int) -> ReferencePath:
        """The recorded path of `agent`."""
        if agent not in self._logged_paths:
            self._logged_paths[agent] = logged_path(self.scenario.log, self.scenario.lane_map, agent)
        return self._logged_paths[agent]

    def _review(
        self,
        futures: Futures,
        known: BoolArray,
        rows: IntArray,
        lag: IntArray,
        residuals: Residuals,
        others: BoolArray,
    ) -> None:
        """Move agents that were off their logs before this step through their life cycle.

        Args:
            futures: of the agents of the step.
            known: mask (r,) of these agents.
            rows: (r,) of all agents off their logs.
            lag: (r,) steps by which their logs lag.
            residuals: of these.
            others: mask (n,) of the agents that may be in conflict with these.
        """
        if not known.any():
            return
        table, mine = futures.table, np.zeros(len(futures.table), np.bool_)
        mine[rows[known]] = True
        in_conflict, unneeded = self._detector.still_in_conflict(futures, mine, others), self._unneeded(table, rows)
        reviewed, rows, residuals = self._diverged.kept(known), rows[known], residuals.kept(known)
        if self._passing is not None:
            may_return = self._passing.may_return(table, reviewed, rows, lag[known], residuals)
            residuals = replace(residuals, known=residuals.known & may_return)
        exemption = self._exemption(table)
        review(self.config, reviewed, table, rows, residuals, in_conflict[rows], exemption, unneeded[known])
        if reviewed is not self._diverged:
            self._diverged = reviewed.joined(self._diverged.kept(~known))

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
            others = self._is_diverged(table)
            others[rows[over]] = False
            over &= ~around(table, others, self._roi_m)[rows]
        return over

    def _exemption(self, table: AgentTable) -> Exemption:
        """The exemption of pairs of background agents that overlap in the log at their places."""

        def exempt(row: int, other: int) -> bool:
            if table.of_ego[other]:
                return False
            a, b = self.scenario.log.ids.searchsorted(table.id[[row, other]]).tolist()
            return self.scenario.log_overlaps.meets(a, b, table.step - self._lag[a], table.x[other], table.y[other])

        return exempt


def review(
    config: TakeoverConfig,
    diverged: DivergedAgents,
    table: AgentTable,
    rows: IntArray,
    residuals: Residuals,
    in_conflict: BoolArray,
    exemption: Exemption = lambda _, __: False,
    unneeded: BoolArray | None = None,
) -> None:
    """Move agents that were off their logs before this step on to their next states, in place.

    An agent in conflict, obstructed or without a log is HELD. One that has been free for long enough is handed back
    along its logged path, and released as soon as the residuals allow it. An unneeded agent is released.

    Args:
        config: when that is.
        diverged: r agents.
        table: all agents.
        rows: (r,) of the agents in `table`.
        residuals: of the agents.
        in_conflict: (r,) whether its log leads into a conflict.
        exemption: of agents that overlap in the log itself.
        unneeded: (r,) whether its log is over and no nearby agent needs it; None for none.
    """
    diverged.in_conflict[:] = in_conflict
    free = residuals.known & ~in_conflict
    at = free.nonzero()[0]
    free[at] = ~obstructed(diverged, at, table, rows, residuals, exemption)
    s = diverged.paths.project(diverged.paths.each, table.x[rows], table.y[rows]).s
    _move_on(
        (diverged.state, diverged.clear),
        free,
        s >= diverged.goal_s,
        table.step - diverged.detected_step,
        (residuals.position, residuals.speed, residuals.yaw),
        np.zeros(len(diverged), np.bool_) if unneeded is None else unneeded,
        (config.clear_steps, config.held_steps_min),
        (config.release_position, config.release_speed, config.release_yaw),
    )
    diverged.return_to_log(diverged.state == HANDBACK)


def obstructed(
    diverged: DivergedAgents,
    at: IntArray,
    table: AgentTable,
    rows: IntArray,
    residuals: Residuals,
    exemption: Exemption = lambda _, __: False,
) -> BoolArray:
    """Whether other agents block the way to the place in the log, except for those that overlap it in the log itself.

    Args:
        diverged: agents off their logs.
        at: (k,) positions of the agents in `diverged`.
        table: all agents.
        rows: (r,) of the agents of `diverged` in `table`.
        residuals: of the agents of `diverged`.
        exemption: of agents that overlap in the log itself.

    Returns:
        mask (k,).
    """
    if not len(at):
        return np.zeros(0, np.bool_)
    paths, rows = diverged.logged_paths, rows[at]
    place = paths.project(at, residuals.x[at], residuals.y[at])
    sight = OBSTACLE_SIGHT + 2.0 * residuals.position[at]
    view = along_paths(paths, table, rows, sight=sight, path=at)
    to_place = place.s - view.own_s
    between = view.ahead & view.in_path & (view.gap < to_place[:, None])
    for k, column, row in view.pairs(between):
        between[k, column] = not exemption(int(rows[k]), row)
    return np.asarray(between.any(axis=1))


@kernel(
    void(
        types.Tuple((OUT_BYTES, OUT_INTS)),
        *(BOOLS, BOOLS, INTS, types.UniTuple(FLOATS, 3), BOOLS),
        *(types.UniTuple(int64, 2), types.UniTuple(float64, 3)),
    )
)
def _move_on(
    states: tuple[ByteArray, IntArray],
    free: BoolArray,
    passed: BoolArray,
    since: IntArray,
    residuals: tuple[FloatArray, FloatArray, FloatArray],
    unneeded: BoolArray,
    least_steps: tuple[int, int],
    largest_residuals: tuple[float, float, float],
) -> None:
    """Update the state of r agents and their numbers of free steps, in place; see :func:`review`.

    Args:
        states: state and number of steps without conflict (r,) of :class:`DivergedAgents`.
        free: (r,) whether it is in no conflict, is not obstructed and has a log.
        passed: (r,) whether it is past its goal.
        since: (r,) steps since it was taken over.
        residuals: position, speed and yaw (r,) of :class:`Residuals`.
        unneeded: (r,) whether no agent needs it.
        least_steps: `clear_steps` and `held_steps_min` of `TakeoverConfig`.
        largest_residuals: `release_position`, `release_speed` and `release_yaw` of `TakeoverConfig`.
    """
    state, clear = states
    position, speed, yaw = residuals
    clear_steps, held_steps_min = least_steps
    release_position, release_speed, release_yaw = largest_residuals
    for k in range(len(state)):
        clear[k] = clear[k] + 1 if free[k] else 0
        needed = clear_steps if passed[k] else 2 * clear_steps
        stays = state[k] == HELD and not (clear[k] >= needed and since[k] >= held_steps_min)
        back = position[k] <= release_position and abs(speed[k]) <= release_speed and abs(yaw[k]) <= release_yaw
        if not free[k] or stays:
            state[k] = HELD
        elif back and state[k] != HELD:
            state[k] = RELEASED
        else:
            state[k] = HANDBACK
        if unneeded[k] and since[k] >= held_steps_min:
            state[k] = RELEASED
