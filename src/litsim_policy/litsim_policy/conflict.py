"""Conflict detection: boxes that will overlap in time and space, the ego by forecast, the background by its log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_predictor.forecast import Forecast
from litsim_sim.geometry import boxes_overlap, to_body
from litsim_sim.log import Log
from litsim_sim.recording import STEP_S
from litsim_sim.scene import AgentTable, BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class ConflictConfig:
    """When two futures count as a conflict.

    Attributes:
        horizon: [s] of the future that is compared; a forecast is trusted no longer.
        margin: [m] by which boxes are lengthened; positive takes over earlier.
    """

    horizon: float = 3.0
    margin: float = 0.0


@dataclass(frozen=True)
class Conflict:
    """Predicted overlap of an agent on its log with another that is off its log.

    Attributes:
        agent: on its log.
        opponent: off its log, or the ego.
        time_to_conflict: [s] until the boxes first overlap.
        pose: (3,) x, y, yaw of the agent then.
    """

    agent: int
    opponent: int
    time_to_conflict: float
    pose: FloatArray


@dataclass(frozen=True)
class Futures:
    """Boxes of n agents at T future instants; arrays (n, T) [m], [rad].

    Attributes:
        valid: whether the agent is on the road then.
    """

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    valid: BoolArray


class ConflictDetector:
    """Compares the futures of agents on their log with those of agents off it.

    Background agents farther than `roi_m` [m] from an agent off its log are not looked at.
    """

    def __init__(self, log: Log, roi_m: float, config: ConflictConfig) -> None:
        self._log, self._roi_m, self._config = log, roi_m, config

    def logged_future(self, table: AgentTable, dt: float) -> Futures:
        """Every agent as its log goes on, at `dt`, 2 `dt`, ... within the horizon.

        An agent on its log keeps the residual that it has now, if any; one off its log is put back onto it at once.
        """
        log, count = self._log, int(self._config.horizon / dt + 1e-9)
        rows = np.searchsorted(log.ids, table.id)
        steps = table.step + round(dt / STEP_S) * np.arange(1, count + 1)
        inside = steps < log.valid.shape[1]
        at = np.minimum(steps, log.valid.shape[1] - 1)
        on_log = ~table.off_log & log.valid[rows, table.step]
        shift_x = np.where(on_log, table.x - log.x[rows, table.step], 0.0)
        shift_y = np.where(on_log, table.y - log.y[rows, table.step], 0.0)
        grid = np.ix_(rows, at)
        return Futures(
            log.x[grid] + shift_x[:, None], log.y[grid] + shift_y[:, None], log.yaw[grid], log.valid[grid] & inside
        )

    def forecast_future(self, table: AgentTable, forecast: Forecast) -> Futures:
        """Every agent as it is forecast; those without a forecast are nowhere."""
        count = int(self._config.horizon / forecast.dt + 1e-9)
        rows = forecast.rows(table.id)
        known = np.repeat((rows >= 0)[:, None], count, axis=1)
        mean = forecast.mean[rows, :count] if len(forecast.id) else np.zeros((len(rows), count, 2))
        yaw = forecast.yaw[rows, :count].astype(np.float64) if len(forecast.id) else np.zeros((len(rows), count))
        return Futures(mean[..., 0], mean[..., 1], yaw, known)

    def first_overlap(
        self, table: AgentTable, futures_a: Futures, futures_b: Futures, pairs: IntArray
    ) -> tuple[IntArray, BoolArray]:
        """First instant at which the boxes of each pair (m, 2) of rows overlap, a in `futures_a`, b in `futures_b`.

        Returns:
            index of the instant (m,), and whether there is one (m,).
        """
        a, b = pairs[:, 0], pairs[:, 1]
        size_a = (table.length[a, None] + self._config.margin, table.width[a, None])
        size_b = (table.length[b, None] + self._config.margin, table.width[b, None])
        dx, dy = futures_b.x[b] - futures_a.x[a], futures_b.y[b] - futures_a.y[a]
        hit = boxes_overlap(dx, dy, futures_a.yaw[a], futures_b.yaw[b], size_a, size_b)
        hit &= futures_a.valid[a] & futures_b.valid[b]
        return np.argmax(hit, axis=1).astype(np.int64), np.asarray(hit.any(axis=1))

    def near(self, table: AgentTable, of: BoolArray, others: BoolArray) -> IntArray:
        """Pairs (m, 2) of rows, the first of `of`, the second of `others`, no farther apart than the ROI."""
        a, b = np.flatnonzero(of), np.flatnonzero(others)
        distance = np.hypot(table.x[a, None] - table.x[None, b], table.y[a, None] - table.y[None, b])
        i, j = np.nonzero(distance <= self._roi_m)
        keep = a[i] != b[j]
        return np.column_stack([a[i], b[j]])[keep]

    def detect(
        self, table: AgentTable, on_log: BoolArray, off_log: BoolArray, logged: Futures, forecast: Futures, dt: float
    ) -> list[Conflict]:
        """Conflicts of agents `on_log` with agents `off_log` (masks (n,)), soonest first, one for each agent.

        An agent that the other one merely follows is not in conflict: whoever runs into a leader's rear could have
        kept his distance, and the leader cannot help it by yielding.
        """
        pairs = self.near(table, on_log, off_log)
        first, hit = self.first_overlap(table, logged, forecast, pairs)
        found: dict[int, Conflict] = {}
        order = np.lexsort((table.id[pairs[:, 1]], table.id[pairs[:, 0]], first))
        for k in order[hit[order]]:
            agent, opponent, at = int(pairs[k, 0]), int(pairs[k, 1]), int(first[k])
            if int(table.id[agent]) in found or _follows(table, opponent, agent):
                continue
            pose = np.array([logged.x[agent, at], logged.y[agent, at], logged.yaw[agent, at]])
            found[int(table.id[agent])] = Conflict(int(table.id[agent]), int(table.id[opponent]), (at + 1) * dt, pose)
        return list(found.values())


def overlap_probability(
    delta: FloatArray, yaw: tuple[float, float], size: tuple[FloatArray, FloatArray], covariance: FloatArray
) -> float:
    """Probability that two boxes overlap when the centre of the second is Gaussian.

    Args:
        delta: (2,) centre of the second, in the mean, minus centre of the first, frame map [m].
        yaw: headings [rad].
        size: length and width (2,) of each [m].
        covariance: (3,) sigma_x, sigma_y [m], correlation.

    Returns:
        the share of the probability mass of a 15 x 15 grid over three standard deviations that overlaps.
    """
    sigma_x, sigma_y, rho = (float(v) for v in covariance)
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(-3, 3, 15), np.linspace(-3, 3, 15)))
    weight = np.exp(-0.5 * (u**2 + v**2))
    dx = delta[0] + sigma_x * u
    dy = delta[1] + sigma_y * (rho * u + np.sqrt(max(0.0, 1.0 - rho**2)) * v)
    (la, wa), (lb, wb) = size
    hit = boxes_overlap(dx, dy, np.full_like(dx, yaw[0]), np.full_like(dx, yaw[1]), (la, wa), (lb, wb))
    return float(weight[hit].sum() / weight.sum())


def _follows(table: AgentTable, follower: int, leader: int) -> bool:
    """Whether `leader` is ahead in the strip that `follower` sweeps straight on."""
    dx = np.array([table.x[leader] - table.x[follower]])
    dy = np.array([table.y[leader] - table.y[follower]])
    ahead, left = to_body(dx, dy, np.array([table.yaw[follower]]))
    clear = 0.5 * (table.length[leader] + table.length[follower])
    beside = 0.5 * (table.width[leader] + table.width[follower])
    return bool(ahead[0] > 0.8 * clear and abs(left[0]) < beside)
