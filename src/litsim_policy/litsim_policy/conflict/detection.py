"""Conflict detection: predicted overlaps of agents on their logs, by the log, with agents off theirs, by forecast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator

from litsim_policy.conflict.futures import OtherMotions, PredictedMotion, follow_logs, hold_back, interpolate, widest
from litsim_policy.conflict.intended import IntentConfig, Intents, intended_motion
from litsim_policy.conflict.overlap_over_time import closing_chances, within_bounds
from litsim_policy.conflict.pairs import followed, near, near_any
from litsim_policy.conflict.weighed import quantile, weighed_chances
from litsim_policy.motion.along_path import Poses
from litsim_predictor.forecast import Forecast, Modes
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
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps


@configuration
class ConflictConfig:
    """When two futures count as a conflict.

    A forecast is a Gaussian around its mean, so two boxes overlap at an instant with a probability. The mean alone is
    the special case `sigma_scale` = 0: the probability is then 1 or 0, and any threshold gives the same. With the
    forecast's spread, threshold 0.5 is nearly the same where only one coordinate is uncertain, as in a lane: the
    probability is a half where the mean boxes touch. Lower thresholds detect a conflict sooner.

    Attributes:
        horizon: of the futures that are compared.
        margin: added to the length of boxes; positive values lead to earlier takeovers.
        probability_threshold: least probability of an overlap at some instant that counts as a conflict.
        probability_clear: likewise for agents that are already off their logs; lower than the threshold, it keeps
            takeovers from flickering.
        sigma_scale: factor on the standard deviations of the forecast.
        braking_time: time for which a hard braking agent is assumed to keep braking, where its forecast expects less;
            0 leaves forecasts unchanged.
        braking_hard: deceleration from which an ego's braking is hard.
        emergency: deceleration from which any agent's braking is hard. No forecast knows the reason for it, and
            agents behind need longer to stop.
        roi_m: radius around an agent off its log within which others are compared; 0 for the scenario's.
        approach_time: others that would reach that radius within this time, at their present rate of approach, are
            compared as well; 0 for the radius alone. Stopping behind a standing agent can take more than 30 m.
        region: off_log: around every agent off its log; ego: the same, but agents are taken over only within `roi_m`
            of the ego.
        closing_time: a conflict within this time is certain and urgent, regardless of the forecast, if it results from
            an agent off its log keeping its acceleration and heading; twice that in an emergency; 0 for the forecast
            alone.
        intent: how agents under control are assumed to continue.
        happened: folder of the outcomes of earlier runs; agents are then taken over by the contacts in it instead of
            predictions, as by an oracle, for experiments; empty for predictions.
    """

    horizon: Horizon = 3.0
    margin: Length = 0.0
    probability_threshold: OpenShare = 0.3
    probability_clear: OpenShare = 0.2
    sigma_scale: NonNegative[Number] = 1.0
    braking_time: NonNegative[Duration] = 1.0
    braking_hard: NonNegative[Acceleration] = 1.0
    emergency: NonNegative[Acceleration] = 4.0
    roi_m: NonNegative[Length] = 0.0
    approach_time: NonNegative[Duration] = 3.0
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
    """Compares the futures of agents on their logs with those of agents off theirs.

    Only background agents in the region of interest of an agent off its log are compared. If two background agents
    overlap in the log itself, and the one off its log is at its logged position then, the overlap is ignored.
    """

    def __init__(self, log: Log, roi_m: float, config: ConflictConfig, overlaps: LogOverlaps | None = None) -> None:
        self._log, self._roi_m, self._config = log, roi_m, config
        self._overlaps = overlaps or LogOverlaps(log)
        self._steps = int(config.horizon / STEP_S + 1e-9)

    def logged_future(self, table: AgentTable, lag: IntArray | None = None) -> PredictedMotion:
        """The future of all agents by their logs.

        An agent on its log keeps its present residual, if any; an agent off its log is put back onto it at once.

        Args:
            table: n agents.
            lag: (n,) steps by which the replay of each log lags; None for no lag.
        """
        log, rows = self._log, self._log.ids.searchsorted(table.id)
        now = np.full(len(table), table.step) if lag is None else table.step - lag
        return PredictedMotion(
            *follow_logs(log.x, log.y, log.yaw, log.valid, rows, now, self._steps, table.x, table.y, ~table.off_log)
        )

    def forecast_future(self, table: AgentTable, forecast: Forecast) -> PredictedMotion:
        """The forecast motion of all agents, for any `dt` of the forecast; not valid for agents without a forecast.

        Between the instants of the forecast, and from the present pose to the first of them, centres, headings and
        covariances are interpolated linearly; now, the covariance is zero. Nothing is valid beyond its last instant.
        Agents that brake hard are moved back along the forecast accordingly; see `ConflictConfig.braking_time`.

        Args:
            table: n agents.
            forecast: of the same step.
        """
        return self.expected_future(table, forecast, np.ones(len(table), np.bool_))

    def expected_future(
        self, table: AgentTable, forecast: Forecast, of: BoolArray, intents: Intents | None = None
    ) -> PredictedMotion:
        """The motion of some agents, as forecast, or as intended under control; not valid for all others.

        Args:
            table: n agents.
            forecast: of the same step.
            of: mask (n,) of these agents.
            intents: agents under control, all of them in `of`; None for none.
        """
        rows = forecast.rows(table.id)
        rows[~of] = -1
        states, valid = self._interpolated(forecast, forecast.dt, rows, (table.x, table.y, table.yaw))
        hard = self._brakes_hard(table) & (rows >= 0)
        for row in hard.nonzero()[0]:
            self._hold_back(states[row], table, int(row))
        config = self._config
        if config.intent.used and intents is not None and len(intents.rows):
            at = intents.rows
            forecasts = PredictedMotion(states[at], valid[at])
            motion = intended_motion(config.intent, intents, table, forecasts, config.sigma_scale)
            states[at], valid[at], rows[at] = motion.states, motion.valid, -1  # no other manoeuvres
        return PredictedMotion(states, valid, self._others(table, forecast, rows, hard))

    def _others(self, table: AgentTable, forecast: Forecast, rows: IntArray, hard: BoolArray) -> OtherMotions:
        """Other manoeuvres of the agents, by `forecast`.

        Args:
            table: n agents.
            forecast: of the same step.
            rows: (n,) of the agents in it; -1 for those not wanted.
            hard: mask (n,) of those that brake hard.
        """
        modes, known = forecast.modes, (rows >= 0).nonzero()[0]
        agent_of = np.full(len(forecast.id), -1, np.int64)
        agent_of[rows[known]] = known
        agent = agent_of[modes.row]
        asked = (agent >= 0).nonzero()[0]
        if not len(asked):
            return OtherMotions.none(self._steps)
        agent = agent[asked]
        kept = modes.probability[asked].astype(np.float64)
        total = forecast.share[modes.row[asked]] + np.bincount(agent, kept, len(table))[agent]
        now = table.x[agent], table.y[agent], table.yaw[agent]
        states, valid = self._interpolated(modes, forecast.dt, asked, now)
        for k in hard[agent].nonzero()[0]:
            self._hold_back(states[k], table, int(agent[k]))
        return OtherMotions(agent, kept / total, states, valid)

    def _interpolated(
        self, motions: Forecast | Modes, dt: float, rows: IntArray, now: Poses
    ) -> tuple[FloatArray, BoolArray]:
        """States (k, T, 6) and validity (k, T) of motions, every 0.1 s.

        Args:
            motions: the most probable motions of a forecast, or its alternatives.
            dt: between the instants of `motions` [s].
            rows: (k,) of the motions in `motions`; -1 for none.
            now: poses (k,) from which they begin.
        """
        return interpolate(
            np.ascontiguousarray(motions.mean),
            np.ascontiguousarray(motions.yaw),
            np.ascontiguousarray(motions.covariance),
            dt,
            rows,
            self._steps,
            self._config.sigma_scale,
            *now,
        )

    def _brakes_hard(self, table: AgentTable) -> BoolArray:
        """Mask (n,) of agents that are assumed to keep braking hard; see `ConflictConfig.braking_time`."""
        config = self._config
        braking = -table.acceleration
        return (braking > 0.0) & (braking >= np.where(table.of_ego, config.braking_hard, config.emergency))

    def _hold_back(self, states: FloatArray, table: AgentTable, row: int) -> None:
        """Hold the motion `states` (T, 6) of the agent in `row` back in place, as its braking requires."""
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

        For alternative manoeuvres of agents of b, see :func:`.weighed.weighed_chances`. Probabilities that do not reach
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
        reached = chance >= threshold
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
