"""Conflict detection: predicted overlaps of agents on their logs, by the log, with agents off theirs, by forecast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_policy.conflict.agent_futures import AgentFutures
from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.futures import PredictedMotion, widest
from litsim_policy.conflict.overlap_over_time import closing_chances, within_bounds
from litsim_policy.conflict.pairs import followed, near, near_any
from litsim_policy.conflict.weighed import quantile, weighed_chances
from litsim_predictor.forecast import Forecast
from litsim_sim.core.nearby import around
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps


@dataclass(frozen=True)
class Conflict:
    """Predicted overlap of an agent on its log with another that is off its log.

    Attributes:
        agent: on its log.
        opponent: off its log, or the ego.
        time_to_conflict: [s] until the probability first reaches the threshold.
        pose: (3,) x, y, yaw of the agent then: the crossing point.
        overlap_probability: the largest within the horizon.
        urgent: whether both close fast; see `ConflictConfig.closing_time`.
    """

    agent: int
    opponent: int
    time_to_conflict: float
    pose: FloatArray
    overlap_probability: float
    urgent: bool = False


class ConflictDetector:
    """Compares the futures of agents on their logs with those of agents off theirs.

    Only background agents in the region of interest of an agent off its log are compared. If two background agents
    overlap in the log itself, and the one off its log is at its logged position then, the overlap is ignored.

    Attributes:
        futures: those that are compared.
    """

    def __init__(self, log: Log, roi_m: float, config: ConflictConfig, overlaps: LogOverlaps | None = None) -> None:
        self._log, self._roi_m, self._config = log, roi_m, config
        self._overlaps = overlaps or LogOverlaps(log)
        self.futures = AgentFutures(log, config)

    def overlap_probability(
        self,
        table: AgentTable,
        futures_a: PredictedMotion,
        futures_b: PredictedMotion,
        pairs: IntArray,
        least: float,
        *,
        first: bool = False,
    ) -> FloatArray:
        """Probability (m, T) that the boxes of each pair (m, 2) of rows overlap, a in `futures_a`, b in `futures_b`.

        For alternative manoeuvres of agents of b, see :func:`.weighed.weighed_chances`. Probabilities that do not reach
        `least` are 0; with `first`, those after the first that does may be, too.
        """
        length = table.length + self._config.margin
        return weighed_chances(pairs, futures_a, futures_b, length, table.width, least, first=first)

    def chances(
        self, table: AgentTable, logged: PredictedMotion, forecast: Forecast, pairs: IntArray, least: float
    ) -> FloatArray:
        """Probability (m, T) that the first of each pair, by its log, overlaps the second, by its forecast."""
        expected = self.futures.forecast(table, forecast)
        return self.overlap_probability(table, logged, expected, pairs, least)

    def around(self, table: AgentTable, agents: BoolArray) -> BoolArray:
        """Mask (n,) of all agents within the ROI's radius of one of `agents` (n,), these included."""
        return around(table, agents, self._roi_m)

    def near_any(self, table: AgentTable, agents: BoolArray) -> BoolArray:
        """Mask (n,) of `agents` (n,), and of all agents in the ROI of one of them or approaching it."""
        time = self._config.approach_time
        return near_any(table.scene, table.x, table.y, table.yaw, table.speed, agents, self._roi_m, time)

    def near(self, table: AgentTable, of: BoolArray, others: BoolArray) -> IntArray:
        """Pairs (m, 2) of rows, the first of `of`, the second of `others`, one in the ROI of the other."""
        time = self._config.approach_time
        return near(table.scene, table.x, table.y, table.yaw, table.speed, of, others, self._roi_m, time)

    def detect(
        self,
        table: AgentTable,
        on_log: BoolArray,
        off_log: BoolArray,
        logged: PredictedMotion,
        expected: PredictedMotion,
        lag: IntArray | None = None,
    ) -> list[Conflict]:
        """Conflicts of agents `on_log` with agents `off_log` (masks (n,)), soonest first, one for each agent.

        `lag` (n,) are the steps by which the logs in `logged` lag; None for no lag.

        An agent is not in conflict with one that merely follows it: the follower could have kept its distance, and the
        leader cannot prevent the collision by yielding.
        """
        threshold = self._config.probability_threshold
        goes_on = self._closing_time(table)
        pairs = self._within_reach(table, logged, expected, self.near(table, on_log, off_log), threshold, goes_on)
        pairs = pairs[~followed(pairs, table.x, table.y, table.yaw, table.length, table.width)]
        chance = self.overlap_probability(table, logged, expected, pairs, threshold)
        closing = self._closing(table, logged, pairs, goes_on)
        np.maximum(chance, closing, out=chance)
        self._excuse(chance, table, pairs, expected, lag)
        return self._soonest(table, logged, pairs, chance, closing)

    def detect_behind(
        self, table: AgentTable, lagged: BoolArray, ahead: BoolArray, logged: PredictedMotion, lag: IntArray
    ) -> list[Conflict]:
        """Conflicts of agents on `lagged` logs with agents `ahead` (masks (n,)) that they follow, as in :meth:`detect`.

        Both are expected where their logs lead, with the lags of `logged`. A log that lags does not know who is ahead
        by now, such as a vehicle that changes lane in front of the agent.
        """
        pairs = self.near(table, lagged, ahead)
        pairs = pairs[followed(pairs[:, ::-1].copy(), table.x, table.y, table.yaw, table.length, table.width)]
        chance = self.overlap_probability(table, logged, logged, pairs, self._config.probability_threshold)
        self._excuse(chance, table, pairs, logged, lag)
        return self._soonest(table, logged, pairs, chance, np.zeros(chance.shape))

    def _soonest(
        self, table: AgentTable, logged: PredictedMotion, pairs: IntArray, chance: FloatArray, closing: FloatArray
    ) -> list[Conflict]:
        """The conflicts of `pairs` (m, 2) by their `chance` (m, T), soonest first, one for each agent.

        Those for which `closing` (m, T) is 1 somewhere are urgent.
        """
        reached = chance >= self._config.probability_threshold
        hit: BoolArray = np.asarray(reached.any(axis=1))
        if not hit.any():
            return []
        first = np.argmax(reached, axis=1)
        found: dict[int, Conflict] = {}
        order = np.lexsort((table.id[pairs[:, 1]], table.id[pairs[:, 0]], first))
        for k in order[hit[order]]:
            agent, opponent, at = int(pairs[k, 0]), int(pairs[k, 1]), int(first[k])
            name = int(table.id[agent])
            if name not in found:
                pose = np.array([logged.x[agent, at], logged.y[agent, at], logged.yaw[agent, at]])
                likely = float(chance[k].max())
                urgent = bool((closing[k] * chance[k]).any())
                found[name] = Conflict(name, int(table.id[opponent]), (at + 1) * STEP_S, pose, likely, urgent)
        return list(found.values())

    def still_in_conflict(
        self,
        table: AgentTable,
        agents: BoolArray,
        off_log: BoolArray,
        logged: PredictedMotion,
        expected: PredictedMotion,
        lag: IntArray | None = None,
    ) -> BoolArray:
        """Mask (n,) of those of `agents` that would be in conflict on their logs, by the lower of both thresholds.

        `lag` as in :meth:`detect`.
        """
        least = self._config.probability_clear
        goes_on = self._closing_time(table)
        pairs = self._within_reach(table, logged, expected, self.near(table, agents, off_log), least, goes_on)
        first = self.overlap_probability(table, logged, expected, pairs, least, first=True)
        closing = self._closing(table, logged, pairs, goes_on)
        hit: BoolArray = np.asarray(first.any(axis=1) | closing.any(axis=1))
        in_log = hit.nonzero()[0]
        in_log = in_log[self._overlap_in_log(table, pairs[in_log])]
        if len(in_log):  # the first step may be excused, and a later one not
            chance = self.overlap_probability(table, logged, expected, pairs[in_log], least)
            np.maximum(chance, closing[in_log], out=chance)
            self._excuse(chance, table, pairs[in_log], expected, lag)
            hit[in_log] = chance.any(axis=1)
        found = np.zeros(len(table), np.bool_)
        found[pairs[hit, 0]] = True
        return found

    def _within_reach(
        self,
        table: AgentTable,
        logged: PredictedMotion,
        expected: PredictedMotion,
        pairs: IntArray,
        least: float,
        goes_on: FloatArray,
    ) -> IntArray:
        """The `pairs` (m, 2) that can overlap, with a probability of at least `least` or closing fast.

        For `goes_on` (n,) see :meth:`_closing_time`.
        """
        now = table.x, table.y, table.speed, table.acceleration
        others = expected.others
        anywhere = widest(expected.bounds, others.row, others.bounds, *now, goes_on)
        length, tail = table.length + self._config.margin, max(0.0, -quantile(least))
        return pairs[within_bounds(pairs, logged.bounds, anywhere, length, table.width, tail)]

    def _closing(self, table: AgentTable, logged: PredictedMotion, pairs: IntArray, goes_on: FloatArray) -> FloatArray:
        """Array (m, T): 1 where the first of `pairs` (m, 2), by its log, hits the second, which continues; else 0."""
        length = table.length + self._config.margin
        now = table.x, table.y, table.yaw, table.speed, table.acceleration
        return closing_chances(pairs, logged.states, logged.valid, *now, length, table.width, goes_on)

    def _closing_time(self, table: AgentTable) -> FloatArray:
        """Times (n,) [s] for which agents are assumed to continue as now; see `ConflictConfig.closing_time`."""
        emergency = -table.acceleration >= self._config.emergency
        return np.where(emergency, 2.0, 1.0) * self._config.closing_time

    def _overlap_in_log(self, table: AgentTable, pairs: IntArray) -> BoolArray:
        """Mask (m,) of `pairs` (m, 2) of rows that overlap at some step of the log; False for pairs with the ego."""
        if not len(pairs):
            return np.zeros(0, np.bool_)
        found: BoolArray = np.asarray(~table.of_ego[pairs].any(axis=1))
        at = found.nonzero()[0]
        found[at] = self._overlaps.any(self._log.ids.searchsorted(table.id[pairs[at]]))
        return found

    def _excuse(
        self, chance: FloatArray, table: AgentTable, pairs: IntArray, expected: PredictedMotion, lag: IntArray | None
    ) -> None:
        """Set probabilities (m, T) to 0, in place, where the log has the overlap of `pairs` (m, 2) as well."""
        some = np.flatnonzero(chance.any(axis=1))
        for k in some[self._overlap_in_log(table, pairs[some])]:
            i, j = pairs[k].tolist()
            now = table.step + 1 + np.arange(chance.shape[1]) - (0 if lag is None else lag[i])
            a, b = self._log.ids.searchsorted(table.id[[i, j]]).tolist()
            chance[k, self._overlaps.excuse(a, b, now, expected.x[j], expected.y[j])] = 0.0
