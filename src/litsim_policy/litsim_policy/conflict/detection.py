"""Conflict detection: boxes that will overlap in time and space, off the log by forecast, on it by the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator

from litsim_policy.conflict.futures import OtherMotions, PredictedMotion, follow_logs, go_on, hold_back, interpolate
from litsim_policy.conflict.intended import IntentConfig, Intents, intended_motion
from litsim_policy.conflict.pairs import followed, near
from litsim_policy.conflict.weighed import weighed_chances
from litsim_predictor.forecast import Forecast
from litsim_sim.core.nearby import around
from litsim_sim.core.quantities import (
    Acceleration,
    Duration,
    Horizon,
    Length,
    NonNegative,
    Number,
    OpenShare,
    at_most,
    configuration,
)
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, Controller, FloatArray, IntArray
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps

CERTAIN = 0.5
"""Probability that motions without any spread have where they overlap, at least."""


@configuration
class ConflictConfig:
    """When two futures count as a conflict.

    A forecast is a Gaussian around its mean, so two boxes overlap at an instant with a probability. The mean alone is
    the special case `sigma_scale` = 0: the probability is then 1 or 0, and any threshold gives the same. With the
    forecast's spread, threshold 0.5 is nearly the same where only one coordinate is uncertain, as in a lane: the
    probability is a half where the mean boxes touch. Lower thresholds see a conflict sooner.

    Attributes:
        horizon: of the future that is compared; a forecast is trusted no longer.
        margin: by which boxes are lengthened; positive takes over earlier.
        probability_threshold: of an overlap at some instant, from which on it is a conflict.
        probability_clear: below which, at every instant, there is none any more; for agents that are off their log
            already. Lower than the threshold, it keeps takeovers from flickering.
        sigma_scale: by which the standard deviations of the forecast are multiplied.
        braking_time: for which an ego that brakes hard is taken to go on doing so, where its forecast does not
            expect as much; 0 leaves forecasts as they are.
        braking_hard: from which on braking is hard.
        roi_m: radius around an agent off its log within which others are looked at; 0 is the scenario's.
        region: off_log: around everybody off the log; ego: of these, agents are taken over within `roi_m` of the ego
            alone.
        closing_time: within which a conflict is certain and urgent, whatever the forecast says, if whoever is off its
            log just keeps its acceleration and heading; 0 asks the forecast alone.
        intent: how agents under control are taken to go on.
        happened: folder of what happened in earlier runs, whose contacts are the conflicts that are found: an oracle,
            for experiments; empty is none.
    """

    horizon: Horizon = 3.0
    margin: Length = 0.0
    probability_threshold: OpenShare = 0.3
    probability_clear: OpenShare = 0.2
    sigma_scale: NonNegative[Number] = 1.0
    braking_time: NonNegative[Duration] = 1.0
    braking_hard: NonNegative[Acceleration] = 1.0
    roi_m: NonNegative[Length] = 0.0
    region: Literal["off_log", "ego"] = "off_log"
    closing_time: NonNegative[Duration] = 1.0
    intent: IntentConfig = IntentConfig()
    happened: str = ""

    @model_validator(mode="after")
    def _check(self) -> ConflictConfig:
        at_most(self, "probability_clear", "probability_threshold")
        return self


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
    """Compares the futures of agents on their log with those of agents off it.

    Background agents farther than `roi_m` [m] from an agent off its log are not looked at. Where two background agents
    overlap in the log itself, and the one that is off its log is where its log has it then, their overlap is none to
    be resolved.
    """

    def __init__(self, log: Log, roi_m: float, config: ConflictConfig, overlaps: LogOverlaps | None = None) -> None:
        self._log, self._roi_m, self._config = log, roi_m, config
        self._overlaps = overlaps or LogOverlaps(log)
        self._steps = int(config.horizon / STEP_S + 1e-9)

    def logged_future(self, table: AgentTable, lag: IntArray | None = None) -> PredictedMotion:
        """Every agent as its log goes on.

        An agent on its log keeps the residual that it has now, if any; one off its log is put back onto it at once.

        Args:
            table: n agents.
            lag: (n,) steps by which the replay of each log lags; None is not at all.
        """
        log, rows = self._log, np.searchsorted(self._log.ids, table.id)
        now = np.full(len(table), table.step) if lag is None else table.step - lag
        return PredictedMotion(
            *follow_logs(log.x, log.y, log.yaw, log.valid, rows, now, self._steps, table.x, table.y, ~table.off_log)
        )

    def forecast_future(self, table: AgentTable, forecast: Forecast, of: BoolArray | None = None) -> PredictedMotion:
        """Every agent as it is forecast, whatever the forecast's `dt`; those without a forecast are nowhere.

        Between the instants of the forecast, and from the present pose to the first of them, centres, headings and
        covariances are interpolated linearly; now, the covariance is zero. Beyond its last instant there is nothing.
        Who brakes hard is moved back along the forecast to where that leads; see `ConflictConfig.braking_time`.

        Args:
            table: n agents.
            forecast: of the same step.
            of: mask (n,) of the agents that are asked for, all others being nowhere; None is all.
        """
        rows = forecast.rows(table.id)
        if of is not None:
            rows[~of] = -1
        states, valid = self._interpolated(table, forecast, rows)
        hard = self._brakes_hard(table) & (rows >= 0)
        for row in np.flatnonzero(hard):
            self._hold_back(states[row], table, int(row))
        return PredictedMotion(states, valid, self._others(table, forecast, rows, hard))

    def _others(self, table: AgentTable, forecast: Forecast, rows: IntArray, hard: BoolArray) -> OtherMotions:
        """What agents may do instead, by `forecast`.

        Args:
            table: n agents.
            forecast: of the same step.
            rows: (n,) of the agents in it; -1 for those that are not asked for.
            hard: mask (n,) of those that brake hard.
        """
        modes = forecast.modes
        if not len(modes):
            return OtherMotions.none(self._steps)
        agent_of = np.full(len(forecast.id), -1, np.int64)
        agent_of[rows[rows >= 0]] = np.flatnonzero(rows >= 0)
        agent = agent_of[modes.row]
        asked = agent >= 0
        agent = agent[asked]
        kept = modes.probability[asked].astype(np.float64)
        total = forecast.share[modes.row[asked]] + np.bincount(agent, kept, len(table))[agent]
        states, valid = interpolate(
            np.ascontiguousarray(modes.mean[asked]),
            np.ascontiguousarray(modes.yaw[asked]),
            np.ascontiguousarray(modes.covariance[asked]),
            forecast.dt,
            np.arange(len(agent)),
            self._steps,
            self._config.sigma_scale,
            table.x[agent],
            table.y[agent],
            table.yaw[agent],
        )
        for k in np.flatnonzero(hard[agent]):
            self._hold_back(states[k], table, int(agent[k]))
        return OtherMotions(agent, kept / total, states, valid)

    def _interpolated(self, table: AgentTable, forecast: Forecast, rows: IntArray) -> tuple[FloatArray, BoolArray]:
        """States (n, T, 6) and validity (n, T) of the most probable motions; `rows` (n,) as in :meth:`_others`."""
        return interpolate(
            np.ascontiguousarray(forecast.mean),
            np.ascontiguousarray(forecast.yaw),
            np.ascontiguousarray(forecast.covariance),
            forecast.dt,
            rows,
            self._steps,
            self._config.sigma_scale,
            table.x,
            table.y,
            table.yaw,
        )

    def _brakes_hard(self, table: AgentTable) -> BoolArray:
        """(n,) egos that brake so hard that they are taken to go on; see `ConflictConfig.braking_time`."""
        return (-table.acceleration >= self._config.braking_hard) & (table.controller == Controller.EGO)

    def _hold_back(self, states: FloatArray, table: AgentTable, row: int) -> None:
        """Move a motion `states` (T, 6) of the agent in `row` back to where its braking leads, in place."""
        speed, braking = table.speed[row], -table.acceleration[row]
        hold_back(states, table.x[row], table.y[row], speed, braking, self._config.braking_time)

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

        Of what agents of b may do instead, see :func:`.weighed.weighed_chances`. Probabilities that do not reach
        `least` are 0; with `first`, those after the first that does may be, too.
        """
        length = table.length + self._config.margin
        return weighed_chances(pairs, futures_a, futures_b, length, table.width, least, first=first)

    def chances(
        self, table: AgentTable, logged: PredictedMotion, forecast: Forecast, pairs: IntArray, least: float
    ) -> FloatArray:
        """Probability (m, T) that the first of each pair, by its log, overlaps the second, by its forecast."""
        expected = self.forecast_future(table, forecast)
        return self.overlap_probability(table, logged, expected, pairs, least)

    def around(self, table: AgentTable, agents: BoolArray) -> BoolArray:
        """(n,) those no farther than the ROI from one of `agents` (n,), and these themselves."""
        return around(table, agents, self._roi_m)

    def near(self, table: AgentTable, of: BoolArray, others: BoolArray) -> IntArray:
        """Pairs (m, 2) of rows, the first of `of`, the second of `others`, no farther apart than the ROI."""
        return near(table.scene, table.x, table.y, of, others, self._roi_m)

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

        `lag` (n,) are the steps by which the logs in `logged` lag; None is not at all.

        An agent that the other one merely follows is not in conflict: whoever runs into a leader's rear could have
        kept his distance, and the leader cannot help it by yielding.
        """
        pairs = self.near(table, on_log, off_log)
        pairs = pairs[~followed(pairs, table.x, table.y, table.yaw, table.length, table.width)]
        threshold = self._config.probability_threshold
        chance = self.overlap_probability(table, logged, expected, pairs, threshold)
        closing = self._closing(table, logged, pairs)
        np.maximum(chance, closing, out=chance)
        self._excuse(chance, table, pairs, expected, lag)
        reached = chance >= threshold
        first = np.argmax(reached, axis=1)
        found: dict[int, Conflict] = {}
        order = np.lexsort((table.id[pairs[:, 1]], table.id[pairs[:, 0]], first))
        for k in order[np.any(reached, axis=1)[order]]:
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
        """(n,) which of `agents` would be in conflict on their log, by the lower of both thresholds.

        `lag` as in :meth:`detect`.
        """
        pairs, least = self.near(table, agents, off_log), self._config.probability_clear
        first = self.overlap_probability(table, logged, expected, pairs, least, first=True)
        closing = self._closing(table, logged, pairs)
        hit: BoolArray = np.asarray(first.any(axis=1) | closing.any(axis=1))
        in_log = np.flatnonzero(hit)
        in_log = in_log[[len(self._logged_overlaps(table, *pairs[k])) > 0 for k in in_log]]
        if len(in_log):  # the first step may be excused, and a later one not
            chance = self.overlap_probability(table, logged, expected, pairs[in_log], least)
            np.maximum(chance, closing[in_log], out=chance)
            self._excuse(chance, table, pairs[in_log], expected, lag)
            hit[in_log] = chance.any(axis=1)
        found = np.zeros(len(table), np.bool_)
        found[pairs[hit, 0]] = True
        return found

    def _closing(self, table: AgentTable, logged: PredictedMotion, pairs: IntArray) -> FloatArray:
        """(m, T) 1 where the first of `pairs` (m, 2), on its log, meets the second going on as it does now; else 0."""
        count = round(self._config.closing_time / STEP_S)
        if not count or not len(pairs):
            return np.zeros((len(pairs), self._steps))
        states = go_on(table.x, table.y, table.yaw, table.speed, table.acceleration, self._steps)
        valid = np.zeros(states.shape[:2], np.bool_)
        valid[:, :count] = True
        return self.overlap_probability(table, logged, PredictedMotion(states, valid), pairs, CERTAIN)

    def intended(self, table: AgentTable, expected: PredictedMotion, intents: Intents) -> PredictedMotion:
        """`expected`, where the agents of `intents` go on by what their policies are doing."""
        config = self._config
        if not config.intent.used or not len(intents.rows):
            return expected
        forecast = expected.take(intents.rows)
        motion = intended_motion(config.intent, intents, table, forecast, config.sigma_scale)
        return expected.with_first(intents.rows, motion)

    def _logged_overlaps(self, table: AgentTable, i: int, j: int) -> IntArray:
        """Steps of the log at which the agents in rows `i` and `j` overlap, if neither is the ego."""
        if Controller.EGO in table.controller[[i, j]]:
            return np.empty(0, np.int64)
        return self._overlaps.steps(*np.searchsorted(self._log.ids, table.id[[i, j]]).tolist())

    def _excuse(
        self, chance: FloatArray, table: AgentTable, pairs: IntArray, expected: PredictedMotion, lag: IntArray | None
    ) -> None:
        """Set probabilities (m, T) to 0, in place, where the log has the overlap of `pairs` (m, 2) as well."""
        for k in np.flatnonzero(chance.any(axis=1)):
            i, j = pairs[k].tolist()
            if len(self._logged_overlaps(table, i, j)):
                now = table.step + 1 + np.arange(chance.shape[1]) - (0 if lag is None else lag[i])
                a, b = np.searchsorted(self._log.ids, table.id[[i, j]]).tolist()
                chance[k, self._overlaps.excuse(a, b, now, expected.x[j], expected.y[j])] = 0.0
