"""Conflict detection: boxes that will overlap in time and space, off the log by forecast, on it by the log."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import model_validator
from scipy.special import ndtri

from litsim_policy.conflict.overlap import Strips
from litsim_predictor.forecast import Forecast
from litsim_sim.core.geometry import to_body, wrap_angle
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

FOLLOWED = 0.8  # of the distance at which boxes in line touch: closer, nobody follows anybody


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
    """

    horizon: Horizon = 3.0
    margin: Length = 0.0
    probability_threshold: OpenShare = 0.4
    probability_clear: OpenShare = 0.2
    sigma_scale: NonNegative[Number] = 1.0
    braking_time: NonNegative[Duration] = 1.0
    braking_hard: NonNegative[Acceleration] = 2.0

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


@dataclass(frozen=True)
class PredictedMotion:
    """Boxes of n agents at T future steps of 0.1 s, the first of them 0.1 s ahead; arrays (n, T) [m], [rad].

    Attributes:
        covariance: (3, n, T) xx, yy, xy of the centre [m2].
        valid: whether the agent is on the road then, as far as is known.
    """

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    covariance: FloatArray
    valid: BoolArray

    @cached_property
    def spread(self) -> FloatArray:
        """(n, T) root of the sum of the variances [m]."""
        return np.sqrt(self.covariance[0] + self.covariance[1])

    @cached_property
    def spread_max(self) -> FloatArray:
        """(n,) largest `spread` of each agent [m]."""
        return np.asarray(self.spread.max(axis=1))

    @cached_property
    def bounds(self) -> FloatArray:
        """(4, n) least x, least y, greatest x, greatest y of the centres while they are valid [m]; else inf, -inf."""
        low = [np.where(self.valid, v, np.inf).min(axis=1) for v in (self.x, self.y)]
        high = [np.where(self.valid, v, -np.inf).max(axis=1) for v in (self.x, self.y)]
        return np.stack([*low, *high])

    def replaced(self, rows: BoolArray, other: PredictedMotion) -> PredictedMotion:
        """These, with those of `other` for the agents of the mask `rows` (n,)."""
        if not rows.any():
            return self
        which = rows[:, None]
        return PredictedMotion(
            np.where(which, other.x, self.x),
            np.where(which, other.y, self.y),
            np.where(which, other.yaw, self.yaw),
            np.where(which, other.covariance, self.covariance),
            np.where(which, other.valid, self.valid),
        )


class ConflictDetector:
    """Compares the futures of agents on their log with those of agents off it.

    Background agents farther than `roi_m` [m] from an agent off its log are not looked at.
    """

    def __init__(self, log: Log, roi_m: float, config: ConflictConfig) -> None:
        self._log, self._roi_m, self._config = log, roi_m, config
        self._steps = np.arange(1, int(config.horizon / STEP_S + 1e-9) + 1)

    def logged_future(self, table: AgentTable, lag: IntArray | None = None) -> PredictedMotion:
        """Every agent as its log goes on.

        An agent on its log keeps the residual that it has now, if any; one off its log is put back onto it at once.

        Args:
            table: n agents.
            lag: (n,) steps by which the replay of each log lags; None is not at all.
        """
        log, last = self._log, self._log.steps - 1
        rows = np.searchsorted(log.ids, table.id)
        now = table.step - (np.zeros(len(table), np.int64) if lag is None else lag)
        steps = now[:, None] + self._steps
        at, grid_rows = np.clip(steps, 0, last), rows[:, None]
        x, y, yaw = log.x[grid_rows, at], log.y[grid_rows, at], log.yaw[grid_rows, at]
        here = np.clip(now, 0, last)
        on_log = ~table.off_log & log.valid[rows, here]
        x += np.where(on_log, table.x - log.x[rows, here], 0.0)[:, None]
        y += np.where(on_log, table.y - log.y[rows, here], 0.0)[:, None]
        return PredictedMotion(
            x, y, yaw, np.zeros((3, *x.shape)), log.valid[grid_rows, at] & (steps >= 0) & (steps <= last)
        )

    def forecast_future(self, table: AgentTable, forecast: Forecast) -> PredictedMotion:
        """Every agent as it is forecast, whatever the forecast's `dt`; those without a forecast are nowhere.

        Between the instants of the forecast, and from the present pose to the first of them, centres, headings and
        covariances are interpolated linearly; now, the covariance is zero. Beyond its last instant there is nothing.
        Who brakes hard is moved back along the forecast to where that leads; see `ConflictConfig.braking_time`.
        """
        shape = (len(table), len(self._steps))
        rows = forecast.rows(table.id) if len(forecast.id) else np.full(len(table), -1)
        known = np.flatnonzero(rows >= 0)
        x, y, yaw = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        covariance, valid = np.zeros((3, *shape)), np.zeros(shape, np.bool_)
        if not len(known):
            return PredictedMotion(x, y, yaw, covariance, valid)
        rows, instants = rows[known], forecast.mean.shape[1]
        time = self._steps * STEP_S / forecast.dt
        before = np.minimum(np.floor(time + 1e-9).astype(np.int64), instants - 1)
        share = time - before

        sigma_x, sigma_y, rho = np.moveaxis(forecast.covariance[rows].astype(np.float64), -1, 0)
        turned = wrap_angle(forecast.yaw[rows].astype(np.float64) - table.yaw[known, None])
        series = np.zeros((6, len(known), instants + 1))
        series[:2, :, 0] = table.x[known], table.y[known]
        series[:2, :, 1:] = np.moveaxis(forecast.mean[rows], -1, 0)
        series[2, :, 1:] = np.unwrap(turned, axis=1)
        series[3:, :, 1:] = sigma_x**2, sigma_y**2, rho * sigma_x * sigma_y
        between = series[..., before] + share * np.diff(series, axis=-1)[..., before]
        x[known], y[known] = between[:2]
        yaw[known] = table.yaw[known, None] + between[2]
        covariance[:, known] = self._config.sigma_scale**2 * between[3:]
        valid[known] = time <= instants + 1e-9
        braking = known[
            (-table.acceleration[known] >= self._config.braking_hard) & (table.controller[known] == Controller.EGO)
        ]
        if len(braking):
            x[braking], y[braking] = self._braked(table, braking, x[braking], y[braking])
        return PredictedMotion(x, y, yaw, covariance, valid)

    def _braked(self, table: AgentTable, rows: IntArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forecast centres (k, T) of the agents in `rows` (k,), none farther along than braking on lets it be."""
        speed, braking = table.speed[rows, None], -table.acceleration[rows, None]
        until = np.minimum(self._config.braking_time, speed / braking)
        time = self._steps * STEP_S
        braked = np.minimum(time, until)
        reach = speed * braked - 0.5 * braking * braked**2 + (speed - braking * until) * (time - braked)
        x, y = (np.concatenate([now[rows, None], then], axis=1) for now, then in ((table.x, x), (table.y, y)))
        travelled = np.cumsum(np.hypot(np.diff(x, axis=1), np.diff(y, axis=1)), axis=1)
        travelled = np.concatenate([np.zeros((len(rows), 1)), travelled], axis=1)
        reach = np.minimum(reach, travelled[:, 1:])
        moved = [np.stack([np.interp(r, s, v) for r, s, v in zip(reach, travelled, c, strict=True)]) for c in (x, y)]
        return moved[0], moved[1]

    def overlap_probability(
        self, table: AgentTable, futures_a: PredictedMotion, futures_b: PredictedMotion, pairs: IntArray, least: float
    ) -> FloatArray:
        """Probability (m, T) that the boxes of each pair (m, 2) of rows overlap, a in `futures_a`, b in `futures_b`.

        Probabilities that cannot reach `least` are not computed, and 0. Three tests of growing cost decide where that
        is so: circles that hold each agent's whole future, circles at each instant, and each strip of the boxes alone.
        """
        a, b = pairs[:, 0], pairs[:, 1]
        found = np.zeros((len(pairs), len(self._steps)))
        length, width = table.length + self._config.margin, table.width
        reach = 0.5 * np.hypot(length, width)
        tail = max(0.0, -float(ndtri(least)))
        away = (reach + tail * futures_a.spread_max)[a] + (reach + tail * futures_b.spread_max)[b]
        near = np.flatnonzero(_may_meet(futures_a, futures_b, pairs, away))
        if not len(near):
            return found
        i, j = a[near], b[near]
        dx, dy = futures_b.x[j] - futures_a.x[i], futures_b.y[j] - futures_a.y[i]
        apart = reach[i, None] + reach[j, None] + tail * futures_a.spread[i] + tail * futures_b.spread[j]
        close = dx**2 + dy**2 < apart**2
        close &= futures_a.valid[i] & futures_b.valid[j]
        pair, step = np.nonzero(close)
        dx, dy, i, j = dx[pair, step], dy[pair, step], i[pair], j[pair]
        strips = Strips.of(futures_a.yaw[i, step], futures_b.yaw[j, step], (length[i], width[i]), (length[j], width[j]))
        covariance = futures_a.covariance[:, i, step] + futures_b.covariance[:, j, step]
        chance = np.zeros(len(dx))
        certain = covariance[0] + covariance[1] <= 0.0
        chance[certain] = strips.take(certain).contain(dx[certain], dy[certain])
        likely = ~certain & strips.can_reach(dx, dy, covariance, least)
        chance[likely] = strips.take(likely).probability(dx[likely], dy[likely], covariance[:, likely])
        found[near[pair], step] = np.where(chance >= least, chance, 0.0)
        return found

    def around(self, table: AgentTable, agents: BoolArray) -> BoolArray:
        """(n,) those no farther than the ROI from one of `agents` (n,), and these themselves."""
        of = np.flatnonzero(agents)
        distance = np.hypot(table.x[of, None] - table.x, table.y[of, None] - table.y)
        return np.asarray((distance <= self._roi_m).any(axis=0))

    def near(self, table: AgentTable, of: BoolArray, others: BoolArray) -> IntArray:
        """Pairs (m, 2) of rows, the first of `of`, the second of `others`, no farther apart than the ROI."""
        a, b = np.flatnonzero(of), np.flatnonzero(others)
        distance = np.hypot(table.x[a, None] - table.x[None, b], table.y[a, None] - table.y[None, b])
        i, j = np.nonzero(distance <= self._roi_m)
        keep = a[i] != b[j]
        return np.column_stack([a[i], b[j]])[keep]

    def detect(
        self,
        table: AgentTable,
        on_log: BoolArray,
        off_log: BoolArray,
        logged: PredictedMotion,
        expected: PredictedMotion,
    ) -> list[Conflict]:
        """Conflicts of agents `on_log` with agents `off_log` (masks (n,)), soonest first, one for each agent.

        An agent that the other one merely follows is not in conflict: whoever runs into a leader's rear could have
        kept his distance, and the leader cannot help it by yielding.
        """
        pairs = self.near(table, on_log, off_log)
        pairs = pairs[~_follows(table, pairs[:, 1], pairs[:, 0])]
        threshold = self._config.probability_threshold
        chance = self.overlap_probability(table, logged, expected, pairs, threshold)
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
    ) -> BoolArray:
        """(n,) which of `agents` would be in conflict on their log, by the lower of both thresholds."""
        pairs = self.near(table, agents, off_log)
        chance = self.overlap_probability(table, logged, expected, pairs, self._config.probability_clear)
        found = np.zeros(len(table), np.bool_)
        found[pairs[chance.any(axis=1), 0]] = True
        return found


def _may_meet(futures_a: PredictedMotion, futures_b: PredictedMotion, pairs: IntArray, reach: FloatArray) -> BoolArray:
    """(m,) False for pairs (m, 2) whose futures stay farther apart than `reach` (m,) [m], whenever they are there."""
    x0, y0, x1, y1 = futures_a.bounds[:, pairs[:, 0]]
    x2, y2, x3, y3 = futures_b.bounds[:, pairs[:, 1]]
    return np.asarray((x0 <= x3 + reach) & (x2 <= x1 + reach) & (y0 <= y3 + reach) & (y2 <= y1 + reach))


def _follows(table: AgentTable, follower: IntArray, leader: IntArray) -> BoolArray:
    """(m,) whether `leader` is ahead in the strip that `follower` sweeps straight on; rows (m,)."""
    dx, dy = table.x[leader] - table.x[follower], table.y[leader] - table.y[follower]
    ahead, left = to_body(dx, dy, table.yaw[follower])
    clear = 0.5 * (table.length[leader] + table.length[follower])
    beside = 0.5 * (table.width[leader] + table.width[follower])
    return np.asarray((ahead > FOLLOWED * clear) & (np.abs(left) < beside))
