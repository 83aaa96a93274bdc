"""Conflict detection: boxes that will overlap in time and space, off the log by forecast, on it by the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator
from scipy.special import ndtri

from litsim_policy.conflict.futures import PredictedMotion, follow_logs, hold_back, interpolate
from litsim_policy.conflict.pairs import followed, near, overlap_chances
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
    """

    horizon: Horizon = 3.0
    margin: Length = 0.0
    probability_threshold: OpenShare = 0.4
    probability_clear: OpenShare = 0.2
    sigma_scale: NonNegative[Number] = 1.0
    braking_time: NonNegative[Duration] = 1.0
    braking_hard: NonNegative[Acceleration] = 2.0
    roi_m: NonNegative[Length] = 0.0
    region: Literal["off_log", "ego"] = "off_log"

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
    """

    agent: int
    opponent: int
    time_to_conflict: float
    pose: FloatArray
    overlap_probability: float


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
        config, rows = self._config, forecast.rows(table.id)
        if of is not None:
            rows[~of] = -1
        states, valid = interpolate(
            np.ascontiguousarray(forecast.mean),
            np.ascontiguousarray(forecast.yaw),
            np.ascontiguousarray(forecast.covariance),
            forecast.dt,
            rows,
            self._steps,
            config.sigma_scale,
            table.x,
            table.y,
            table.yaw,
        )
        hard = (-table.acceleration >= config.braking_hard) & (table.controller == Controller.EGO) & (rows >= 0)
        for row in np.flatnonzero(hard):
            speed, braking = table.speed[row], -table.acceleration[row]
            hold_back(states[row], table.x[row], table.y[row], speed, braking, config.braking_time)
        return PredictedMotion(states, valid)

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

        Probabilities that do not reach `least` are 0; with `first`, those after the first that does, too.
        """
        a, b = futures_a, futures_b
        return overlap_chances(
            pairs,
            a.states,
            a.valid,
            a.bounds,
            b.states,
            b.valid,
            b.bounds,
            table.length + self._config.margin,
            table.width,
            least,
            float(ndtri(least)),
            first,
        )

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
                found[name] = Conflict(name, int(table.id[opponent]), (at + 1) * STEP_S, pose, likely)
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
        hit: BoolArray = np.asarray(first.any(axis=1))
        in_log = np.flatnonzero(hit)
        in_log = in_log[[len(self._logged_overlaps(table, *pairs[k])) > 0 for k in in_log]]
        if len(in_log):  # the first step may be excused, and a later one not
            chance = self.overlap_probability(table, logged, expected, pairs[in_log], least)
            self._excuse(chance, table, pairs[in_log], expected, lag)
            hit[in_log] = chance.any(axis=1)
        found = np.zeros(len(table), np.bool_)
        found[pairs[hit, 0]] = True
        return found

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
