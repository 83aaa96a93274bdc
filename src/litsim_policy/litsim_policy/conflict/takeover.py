"""The life cycle of a takeover: LOG, HELD by the policy or on by its OWN_INTENT, HANDBACK to the log, RELEASED."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import ConflictDetector, soonest
from litsim_policy.conflict.diverged import HANDBACK, HELD, OWN_INTENT, RELEASED, DivergedAgents, DivergedNow
from litsim_policy.conflict.futures import Futures, PlannedPaths
from litsim_policy.conflict.likelihood import LogLikelihood, LogRatios, unlikely_logs, with_changed
from litsim_policy.conflict.opening import by_conflict, by_late_entry
from litsim_policy.conflict.own_intent import drive_by_own_intent
from litsim_policy.conflict.passing import Passing
from litsim_policy.conflict.walking import WaysAhead
from litsim_policy.conflict.way_back import obstructed, unneeded
from litsim_policy.motion.route import Router
from litsim_predictor.forecast import Forecast
from litsim_sim.core.nearby import around
from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.scene import AgentTable, BoolArray, IntArray
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.kernels.compiled import Bools, Floats, OutBytes, OutInts, kernel
from litsim_sim.scenario.setting import Setting

ITERATIONS_MAX = 10  # bound on the iterations of detection within a step; queues of four need four

UNLIKELY_STILL = 0.5  # of `ConflictConfig.unlikely`, at which the log of an agent that is off it is still unlikely

# Largest residuals with which a hand-back ends. The speed is the highest at which queues do not keep growing lags: the
# last of a queue of four has a lag of 6.8 s, with 2 m/s 11.6 s.
RELEASE_POSITION, RELEASE_SPEED, RELEASE_YAW = 0.5, 1.5, 0.1  # [m], [m/s], [rad]


class TakeoverManager:
    """The conflict stage: :meth:`update` is called once a step, in order.

    Attributes:
        iterations, converged: (scenes,) of the last update, as in :class:`TakeoverTable`.
    """

    def __init__(self, scenario: Setting, config: ConflictConfig) -> None:
        """Begin without takeovers; batched scenes of `scenario` do not influence each other."""
        self._scenario, self._config = scenario, config
        self._roi_m = config.roi_m or scenario.roi_m
        self._detector = ConflictDetector(scenario.log, self._roi_m, config, scenario.log_overlaps)
        self._walkers_wait = config.walkers and config.handback == "time_shift"
        self._likelihood = LogLikelihood(scenario.log) if config.unlikely > 0.0 else None
        self._router = Router(scenario.lane_map)
        self._passing = Passing(scenario.lane_map, self._router) if config.passing else None
        self.iterations: IntArray = np.zeros(len(scenario.ego_ids), np.int64)
        self.converged: BoolArray = np.ones(len(scenario.ego_ids), np.bool_)
        self._diverged = DivergedAgents.empty()
        self._suspected: dict[int, int] = {}  # steps in a row for which each agent has been in conflict
        self._lag: IntArray = np.zeros(len(scenario.log.ids), np.int64)  # of each log, or that after a return to it

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:
        """Returns the agents off their logs at this step, and why."""
        if self._likelihood is not None:
            self._likelihood.observe(table)
        if table.step < self._scenario.history_steps:
            return TakeoverTable(table.step)
        self._diverged = self._diverged.kept(table.rows(self._diverged.agent) >= 0)
        before = self._is_diverged(table)
        if late := list(by_late_entry(self._scenario, table, before)):
            self._diverged = self._diverged.joined(*late)
            before = self._is_diverged(table)
        lag = self._choose_lags(table)
        lagged = (lag > 0) & ~table.off_log
        keep_to_log = lagged | (table.obstacle & ~table.off_log)
        planned = partial(self._planned_paths, table)
        futures = Futures(self._scenario.log, self._config, table, forecast, lag, keep_to_log, planned)
        ratios = self._judge_logs(table, lag)
        walking = (table.obstacle if self._walkers_wait else np.zeros(len(table), np.bool_)).nonzero()[0]
        ways = WaysAhead.of(self._scenario.log, table, walking, lag[walking])
        opponents = self._take_over(futures, before, lagged, ratios, ways) | keep_to_log
        self._diverged.log_ratio = ratios.ratio[table.rows(self._diverged.agent)]
        now = DivergedNow.at(self._scenario.log, self._diverged, table, lag)
        self._review(now, before[now.rows], futures, opponents, ways)
        if self._passing is not None and len(self._diverged):
            self._passing.change_lanes(now)
        takeovers = now.report()
        self._diverged = self._diverged.kept(self._diverged.state != RELEASED)
        return TakeoverTable(table.step, takeovers, int(self.iterations.max()), bool(self.converged.all()))

    def _is_diverged(self, table: AgentTable) -> BoolArray:
        """Returns the mask (n,) of the ego and of driven agents."""
        diverged = table.mask(self._scenario.ego_ids)
        diverged[table.rows(self._diverged.agent)] = True
        return diverged

    def _choose_lags(self, table: AgentTable) -> IntArray:
        """Returns the steps (n,) by which the log of each agent lags, or would after a return to it at this step."""
        log, agents = self._scenario.log, self._diverged.agent
        rows, log_rows = table.rows(agents), log.ids.searchsorted(agents)
        self._lag[log_rows] = 0
        if self._config.handback == "time_shift":
            self._lag[log_rows] = log.lags(log_rows, table.step, table.x[rows], table.y[rows])
        return self._lag[log.ids.searchsorted(table.id)]

    def _judge_logs(self, table: AgentTable, lag: IntArray) -> LogRatios:
        """Returns how likely logs are, which lag by `lag` (n,) steps; all are equal if overlaps alone count."""
        if self._likelihood is None:
            return LogRatios.equal(lag)
        return self._likelihood.at(table, lag, ~(table.of_ego | table.obstacle))

    def _planned_paths(self, table: AgentTable, among: BoolArray) -> PlannedPaths:
        """Returns those in the mask `among` (n,) of the agents under control so far at this step, and their paths."""
        diverged = self._diverged
        rows = table.rows(diverged.agent)
        index = among[rows].nonzero()[0]
        return PlannedPaths(rows[index], diverged.paths_of(index), diverged.detected_step[index] == table.step)

    def _take_over(
        self, futures: Futures, before: BoolArray, lagged: BoolArray, ratios: LogRatios, ways: WaysAhead
    ) -> BoolArray:
        """Take over agents with confirmed conflicts; return the mask (n,) of agents off their logs now, as `before`.

        So are agents whose logs have become unlikely, by their `ratios`. The first iteration compares with all agents
        off their logs or on `lagged` ones, each further one with those that the previous one has taken over.
        Pedestrians and cyclists are taken over where somebody is in their `ways`, for no other reason.
        """
        table, suspected = futures.table, dict[int, int]()
        outside = np.zeros(len(table), np.bool_)
        if self._config.region == "ego":
            outside = ~around(table, table.mask(self._scenario.ego_ids), self._roi_m)
        barred = table.obstacle | outside
        self.iterations, done = np.zeros(len(self.iterations), np.int64), 0
        diverged, fresh = before, before | lagged
        while fresh.any() and done < ITERATIONS_MAX:
            done += 1
            self.iterations[table.scene[fresh]] = done
            previous, diverged = diverged, diverged.copy()
            conflicts = with_changed(self._detector.conflicts(futures, ~previous & ~barred, fresh), ratios, table)
            if done == 1 and lagged.any():
                conflicts = soonest(conflicts, *self._detector.conflicts_of_lagged(futures, before, lagged, barred))
            if done == 1:
                unlikely = (ratios.ratio < -self._config.unlikely) & ~previous & ~barred
                conflicts = soonest(conflicts, unlikely_logs(ratios, table, self._scenario.log, unlikely))
                conflicts = soonest(conflicts, ways.conflicts(table, ~previous & ~outside))
            opened = []
            for conflict in conflicts:
                count = suspected[conflict.agent] = self._suspected.get(conflict.agent, 0) + 1
                soon = conflict.urgent or conflict.time_to_conflict <= self._config.urgent_time
                if soon or count >= self._config.confirm_steps:
                    opened.append(by_conflict(self._scenario, self._router, table, conflict))
                    diverged[table.row(conflict.agent)] = True
            self._diverged = self._diverged.joined(*opened) if opened else self._diverged
            fresh = diverged & ~previous
        self._suspected = suspected
        self.converged = np.ones(len(self.converged), np.bool_)
        self.converged[table.scene[fresh]] = False
        return diverged

    def _review(
        self, now: DivergedNow, off_before: BoolArray, futures: Futures, opponents: BoolArray, ways: WaysAhead
    ) -> None:
        """Move agents that were `off_before` (mask (r,)) to be off their logs before this step on to their next states.

        They may be in conflict with `opponents` (mask (n,)); pedestrians and cyclists with those in their `ways`.
        """
        if not off_before.any():
            return
        mine = np.zeros(len(now.table), np.bool_)
        mine[now.rows[off_before]] = True
        pairs = self._detector.pairs(futures, mine & ~now.table.obstacle, opponents)
        in_conflict = self._detector.still_in_conflict(futures, pairs)[now.rows]
        in_conflict |= ways.blocked(len(now.table))[now.rows]
        in_conflict |= now.agents.log_ratio < -UNLIKELY_STILL * self._config.unlikely
        now.agents.in_conflict[off_before] = in_conflict[off_before]
        free = off_before & now.recorded & ~in_conflict
        if self._passing is not None:
            free &= self._passing.may_return(now, off_before)
        index = free.nonzero()[0]
        free[index] = ~obstructed(now, index, self._scenario.log_overlaps)
        own = drive_by_own_intent(self._config, self._detector, now, futures, pairs)
        move_on(self._config, now, off_before, free, own, unneeded(self._scenario, now, self._roi_m))


def move_on(
    config: ConflictConfig,
    now: DivergedNow,
    off_before: BoolArray,
    free: BoolArray,
    own: BoolArray,
    needless: BoolArray,
) -> None:
    """Move agents off their logs, those of the mask `off_before` (r,), on to their next states, in place.

    An agent that is not `free` (r,), as it is in conflict or its way back is taken, is HELD, or drives on by its `own`
    (r,) intent. One that has been free for long enough is handed back along its logged path, and released as soon as
    the residuals allow it. A `needless` one (r,) is released: its log is over and no agent nearby needs it.
    """
    agents, paths = now.agents, now.agents.paths
    may_end = agents.detected_step <= now.table.step - config.held_steps_min
    passed = paths.project(paths.each, now.x, now.y).s >= agents.goal_s
    walks, turn = now.table.obstacle[now.rows], now.yaw - now.log_yaw
    residuals, at_once = (now.residual_position, now.residual_speed, turn), config.handback == "at_once"
    moving = Moving(off_before, free, own, needless & may_end, may_end, passed, walks, *residuals)
    _move_on(moving, config.clear_steps, at_once, agents.clear, agents.state)
    agents.return_to_log((off_before & (agents.state == HANDBACK)).nonzero()[0])


class Moving(NamedTuple):
    """What decides on the next states of agents off their logs; arrays (r,).

    Attributes:
        off_before, free, own: see :func:`move_on`.
        needless: whether it is released, since nobody needs it.
        may_end: whether it has been held for long enough.
        passed: whether it has passed its goal.
        walks: whether it walks or cycles; who walks turns on the spot.
        position, speed, turn: residuals of its place [m], speed [m/s] and heading [rad].
    """

    off_before: Bools
    free: Bools
    own: Bools
    needless: Bools
    may_end: Bools
    passed: Bools
    walks: Bools
    position: Floats
    speed: Floats
    turn: Floats


@kernel
def _move_on(moving: Moving, clear_steps: int, at_once: bool, clear: OutInts, state: OutBytes) -> None:
    """Write for how many steps agents have been free, `clear` (r,), and their next states `state` (r,).

    Those that are handed back are released where they are back at their logs, or `at_once`.
    """
    for k in range(len(state)):
        if not moving.off_before[k]:
            continue
        clear[k] = clear[k] + 1 if moving.free[k] else 0
        enough = clear[k] >= (clear_steps if moving.passed[k] else 2 * clear_steps)
        handed_back = state[k] == HANDBACK
        if moving.needless[k]:
            state[k] = RELEASED
        elif not (moving.free[k] and (handed_back or (moving.may_end[k] and enough))):
            state[k] = OWN_INTENT if moving.own[k] else HELD
        else:
            near = moving.position[k] <= RELEASE_POSITION and abs(moving.speed[k]) <= RELEASE_SPEED
            back = near and (moving.walks[k] or abs(wrapped(moving.turn[k])) <= RELEASE_YAW)
            state[k] = RELEASED if handed_back and (back or at_once) else HANDBACK
