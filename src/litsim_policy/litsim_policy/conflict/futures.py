"""Where agents will be: by their logs, by forecast, or on the paths that they were given under control.

For other agents, a predictor estimates path and speed. For an agent under control, the path and the current command of
its policy are known. Its later progress along the path is left to the forecast, which considers the agents ahead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.predicted_motion import XX, XY, YAW, YY, AlternativeMotions, PredictedMotion, X, Y
from litsim_policy.motion.along_path import Poses
from litsim_policy.motion.path_batch import PathBatch, nearest, place_at
from litsim_predictor.forecast import Forecast, Modes
from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.scene import STEP_S, AgentArrays, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    Bools,
    Bools2,
    Floats,
    Floats2,
    Floats3,
    Ints,
    OutBools2,
    OutFloats2,
    OutFloats3,
    Singles2,
    Singles3,
    kernel,
)
from litsim_sim.scenario.log import Log

BRAKING_HARD = 1.0
"""Deceleration [m/s2] from which an ego's braking is hard: raised the recall of conflicts at a threshold of 0.3 from 43
to 68 %, at a precision of 95 and 94 %."""

STANDING, STARTING = 0.3, 0.3
"""Speed [m/s] below which, and acceleration [m/s2] up to which, a vehicle stands on: what a walking pace and a gentle
start clearly exceed. Untuned. A forecast lets whoever stands in a queue start and drift aside."""

# How an agent under control continues. 3 s ahead, its lateral error on its path is 0.05 m, that of the plain forecast
# 0.37 m; only along the path, and only after 2 s, the forecast is better.
HOLD = 1.0  # [s] for which it keeps its acceleration; after that, it keeps its speed
FADE = 2.0  # [s] after HOLD within which the forecast's progress along the path takes over
SETTLE = 1.0  # [s] time constant of its return to the path
SIGMA_START = 0.1  # [m] standard deviation at the start
ALONG_LINEAR, ALONG_QUADRATIC, ACROSS_LINEAR = 0.05, 0.25, 0.03  # [m/s], [m/s2], [m/s] its growth along and across

ROUNDING = 1e-9  # share of a step by which an instant of a forecast may differ from a step that it falls on


class Boxes(NamedTuple):
    """n agents now; arrays (n,).

    Attributes:
        x, y, yaw, speed, acceleration: [m], [rad], [m/s], [m/s2].
        length, width: of the boxes that are compared [m].
        time: for which they may continue straight on [s].
    """

    x: Floats
    y: Floats
    yaw: Floats
    speed: Floats
    acceleration: Floats
    length: Floats
    width: Floats
    time: Floats


@dataclass
class PlannedPaths:
    """The agents under control at a step, rows ascending, and their paths; see :func:`go_as_planned`.

    Attributes:
        rows: (r,) in the table.
        paths: of these agents.
        fresh: (r,) whether the agent was taken over in this very step, so that its policy has not acted yet.
    """

    rows: IntArray
    paths: PathBatch
    fresh: BoolArray

    def moved_to(self, rows: IntArray) -> PlannedPaths:
        """Returns the same for a table made of the `rows` (k,), ascending, which include all of these agents."""
        return PlannedPaths(rows.searchsorted(self.rows), self.paths, self.fresh)


class Futures:
    """The futures of agents at one step, every 0.1 s up to the horizon of `config`, made where they are asked for.

    Conflicts are looked for only near agents off their logs, which are few, so :meth:`cover` makes the futures of some
    agents at a time. The results are the same as with the futures of all agents.

    Attributes:
        table: all n agents of the step.
        rows: (k,) rows in `table`, ascending, of the agents that are covered.
        place: (n,) of each agent of `table` that is covered among these.
        covered: these agents.
        log_rows: (k,) of them in the log.
        boxes: that they occupy now, which are assumed to continue as now for `ConflictConfig.closing_time`.
        lag: (k,) steps by which their logs lag.
        by_log: where their logs lead. An agent on its log keeps its present residual, if any; an agent off its log is
            put back onto it at once.
        expected: where they are expected otherwise: on lagged logs, as planned, or as forecast; not valid for agents
            of which that was not asked.
    """

    rows: IntArray
    place: IntArray
    covered: AgentTable
    log_rows: IntArray
    boxes: Boxes
    lag: IntArray
    by_log: PredictedMotion
    expected: PredictedMotion

    def __init__(
        self,
        log: Log,
        config: ConflictConfig,
        table: AgentTable,
        forecast: Forecast,
        lag: IntArray | None = None,
        keep_to_log: BoolArray | None = None,
        planned: Callable[[BoolArray], PlannedPaths] | None = None,
    ) -> None:
        """Begin a step, with no agent covered.

        Replays of logs lag by `lag` (n,) steps, and agents `keep_to_log` (mask (n,)) are expected to follow
        them: those on lagged logs, and pedestrians and cyclists. `planned` returns those in a mask (n,) of the
        agents under control by now, and their paths. None stands for no lag, and none.
        """
        self._log, self._config, self.table, self._forecast = log, config, table, forecast
        self._lag = np.zeros(len(table), np.int64) if lag is None else lag
        self._keep_to_log = np.zeros(len(table), np.bool_) if keep_to_log is None else keep_to_log
        self._planned = planned
        self._steps = int(config.horizon / STEP_S + 1e-9)
        self._is_covered = np.zeros(len(table), np.bool_)
        self._asked = np.zeros(len(table), np.bool_)
        self.rows = np.empty(0, np.int64)

    @property
    def sizes(self) -> tuple[FloatArray, FloatArray]:
        """Lengths and widths (k,) of the boxes of the covered agents [m]."""
        return self.boxes.length, self.boxes.width

    def cover(self, agents: BoolArray, expected: BoolArray) -> None:
        """Make the missing futures of the mask `agents` (n,), and expected ones of those also in the mask `expected`.

        Motions by the log are made of all of them.
        """
        missing = agents & ~self._is_covered
        if not len(self.rows) or missing.any():
            self._is_covered |= missing
            self.rows, self.place = self._is_covered.nonzero()[0], self._is_covered.cumsum() - 1
            self.covered, self.lag = self.table.take(self.rows), self._lag[self.rows]
            self.log_rows = self._log.ids.searchsorted(self.covered.id)
            self.boxes = self._boxes()
            self.by_log = self._by_log()
            self._asked |= expected
            self.expected = self._expected(self._asked & self._is_covered)
        elif (asked := expected & ~self._asked).any():
            self._asked |= asked
            self.expected = self.expected.replaced(asked[self.rows], self._expected(asked & self._is_covered))

    def _boxes(self) -> Boxes:
        """Returns the boxes of the covered agents, which continue longer if they brake for an emergency.

        Agents on lagged logs do not: where they go is known, and their recorded accelerations and headings are noisy.
        """
        table, config = self.covered, self._config
        time = np.where(-table.acceleration >= config.emergency, 2.0, 1.0) * config.closing_time
        time[self._keep_to_log[self.rows]] = 0.0
        motion, size = (table.speed, table.acceleration), (table.length + config.margin, table.width)
        return Boxes(table.x, table.y, table.yaw, *motion, *size, time)

    def _by_log(self) -> PredictedMotion:
        """Returns the motion of the covered agents by their logs."""
        log, table = self._log, self.covered
        motion, now = (log.x, log.y, log.yaw, log.valid), table.step - self.lag
        return PredictedMotion(*follow_logs(motion, self.log_rows, now, self._steps, table.x, table.y, ~table.off_log))

    def _expected(self, asked: BoolArray) -> PredictedMotion:
        """Returns the expected motion of the covered agents in the mask `asked` (n,); not valid for all others."""
        table, keep_to_log = self.covered, self._keep_to_log[self.rows]
        forecast_rows = self._forecast.rows(table.id)
        forecast_rows[~asked[self.rows] | keep_to_log] = -1
        states, valid = self._interpolated(self._forecast, forecast_rows, (table.x, table.y, table.yaw))
        stands = (table.speed < STANDING) & (table.acceleration <= STARTING) & (forecast_rows >= 0)
        self._leave_standing(states, stands)
        forecast_rows[stands] = -1  # they have no other manoeuvres
        hard = self._brakes_hard() & (forecast_rows >= 0)
        for row in hard.nonzero()[0]:
            self._hold_back(states[row], int(row))
        planned = None
        if self._planned is not None and self._config.planned_motion:
            planned = self._planned(asked & ~self._keep_to_log).moved_to(self.rows)
            forecast_rows[planned.rows] = -1  # they have no other manoeuvres
        alternatives = self._alternatives(forecast_rows, hard)
        if planned is not None:
            go_as_planned(
                planned.paths, planned.rows, planned.fresh, table.arrays, self._config.sigma_scale, states, valid
            )
        motions = PredictedMotion(states, valid, alternatives)
        motions.put(keep_to_log, self.by_log)
        return motions

    def _alternatives(self, forecast_rows: IntArray, hard: BoolArray) -> AlternativeMotions:
        """Returns other manoeuvres of the covered agents, by the forecast, of which those `hard` (k,) brake hard.

        `forecast_rows` (k,) are those of the agents in the forecast; -1 for those not wanted.
        """
        forecast, table = self._forecast, self.covered
        modes, rows = forecast.modes, (forecast_rows >= 0).nonzero()[0]
        agent_of = np.full(len(forecast.id), -1, np.int64)
        agent_of[forecast_rows[rows]] = rows
        agent = agent_of[modes.row]
        wanted = (agent >= 0).nonzero()[0]
        if not len(wanted):
            return AlternativeMotions.none(self._steps)
        agent = agent[wanted]
        probability = modes.probability[wanted].astype(np.float64)
        total = forecast.share[modes.row[wanted]] + np.bincount(agent, probability, len(table))[agent]
        states, valid = self._interpolated(modes, wanted, (table.x[agent], table.y[agent], table.yaw[agent]))
        for k in hard[agent].nonzero()[0]:
            self._hold_back(states[k], int(agent[k]))
        return AlternativeMotions(agent, probability / total, states, valid)

    def _interpolated(self, motions: Forecast | Modes, rows: IntArray, now: Poses) -> tuple[FloatArray, BoolArray]:
        """Returns states (k, T, 6) and validity (k, T) of `motions` in `rows` (k,), -1 for none, every 0.1 s.

        Between the instants of the forecast, and from the pose `now` to the first of them, centres, headings
        and covariances are interpolated linearly; now, the covariance is zero. Nothing is valid beyond its last
        instant.
        """
        mean, yaw, covariance = map(np.ascontiguousarray, (motions.mean, motions.yaw, motions.covariance))
        gaussians, scale = (mean, yaw, covariance), self._config.sigma_scale
        return interpolate(gaussians, self._forecast.dt, rows, self._steps, scale, now)

    def _brakes_hard(self) -> BoolArray:
        """Mask (k,) of covered agents that are assumed to keep braking hard; see `ConflictConfig.braking_time`."""
        config, table = self._config, self.covered
        braking = -table.acceleration
        return (braking > 0.0) & (braking >= np.where(table.of_ego, BRAKING_HARD, config.emergency))

    def _leave_standing(self, states: FloatArray, stands: BoolArray) -> None:
        """Let covered agents in the mask `stands` (k,) be for certain where they are, in `states` (k, T, 6), in place.

        A vehicle that stands does so until there is a reason; once it starts, its forecast is believed.
        """
        if not stands.any():
            return
        table = self.covered
        states[stands] = 0.0
        for column, now in ((X, table.x), (Y, table.y), (YAW, table.yaw)):
            states[stands, :, column] = now[stands, None]

    def _hold_back(self, states: FloatArray, row: int) -> None:
        """Hold the motion `states` (T, 6) of the covered agent in `row` back in place, as its braking requires."""
        table = self.covered
        speed, braking = table.speed[row], -table.acceleration[row]
        hold_back(states, table.x[row], table.y[row], speed, braking, self._config.braking_time)


@kernel
def follow_logs(
    log: tuple[Floats2, Floats2, Floats2, Bools2],
    rows: Ints,
    now: Ints,
    count: int,
    x: Floats,
    y: Floats,
    on_log: Bools,
) -> tuple[Floats3, Bools2]:
    """Return `states` (n, T, 6) and `valid` (n, T) of agents by their logs, for T = `count` steps.

    The `log` is x, y [m], yaw [rad] and validity (N, S). Agents are in its `rows` (n,), at steps `now` (n,), and
    those `on_log` (n,) keep their residual, by which they are at `x`, `y` (n,) [m].
    """
    log_x, log_y, log_yaw, log_valid = log
    last = log_x.shape[1] - 1
    states, valid = np.zeros((len(rows), count, 6)), np.zeros((len(rows), count), np.bool_)
    for k in range(len(rows)):
        row, here = rows[k], min(max(now[k], 0), last)
        off_x, off_y = 0.0, 0.0
        if on_log[k] and log_valid[row, here]:
            off_x, off_y = x[k] - log_x[row, here], y[k] - log_y[row, here]
        for t in range(count):
            step = now[k] + t + 1
            logged = min(max(step, 0), last)
            states[k, t, X], states[k, t, Y] = log_x[row, logged] + off_x, log_y[row, logged] + off_y
            states[k, t, YAW] = log_yaw[row, logged]
            valid[k, t] = step == logged and log_valid[row, logged]
    return states, valid


@kernel
def interpolate(
    motions: tuple[Floats3, Singles2, Singles3],
    dt: float,
    rows: Ints,
    count: int,
    sigma_scale: float,
    now: tuple[Floats, Floats, Floats],
) -> tuple[Floats3, Bools2]:
    """Return `states` (n, T, 6) and `valid` (n, T) by forecast, for T = `count` steps, linear between its instants.

    Mean (N, F, 2), yaw (N, F) and covariance (N, F, 3) are those of :class:`litsim_predictor.forecast.Forecast`, in
    which agents are in `rows` (n,), -1 for none. They begin at x, y [m] and yaw [rad] `now` (n,).
    """
    mean, yaw, sigmas = motions
    x_now, y_now, yaw_now = now
    instants = mean.shape[1]
    states, valid = np.zeros((len(rows), count, 6)), np.zeros((len(rows), count), np.bool_)
    before, after = np.zeros(6), np.zeros(6)
    for k in range(len(rows)):
        row, reached = rows[k], -1
        if row < 0 or instants == 0:
            continue
        after[:] = 0.0
        after[X], after[Y], after[YAW] = x_now[k], y_now[k], yaw_now[k]
        for t in range(count):
            time = (t + 1) * STEP_S / dt
            instant = min(math.floor(time + ROUNDING), instants - 1)
            while reached < instant:
                reached += 1
                before[:] = after
                sigma_x, sigma_y = np.float64(sigmas[row, reached, 0]), np.float64(sigmas[row, reached, 1])
                after[X], after[Y] = mean[row, reached, 0], mean[row, reached, 1]
                after[YAW] = before[YAW] + wrapped(np.float64(yaw[row, reached]) - before[YAW])
                after[XX], after[YY] = sigma_x**2, sigma_y**2
                after[XY] = np.float64(sigmas[row, reached, 2]) * sigma_x * sigma_y
            for c in range(6):
                states[k, t, c] = before[c] + (time - instant) * (after[c] - before[c])
            for c in range(XX, XY + 1):
                states[k, t, c] *= sigma_scale**2
            valid[k, t] = time <= instants + ROUNDING
    return states, valid


@kernel
def hold_back(states: OutFloats2, x: float, y: float, speed: float, braking: float, braking_time: float) -> None:
    """Limit a forecast (T, 6), in place, to the distance that a vehicle covers if it continues to brake.

    It is at `x`, `y` [m], and goes on `braking` [m/s2] for `braking_time` [s], unless it stands sooner.
    """
    count = len(states)
    places, travelled = np.empty((count + 1, 2)), np.zeros(count + 1)
    places[0, 0], places[0, 1] = x, y
    for t in range(count):
        places[t + 1, 0], places[t + 1, 1] = states[t, X], states[t, Y]
        step = math.hypot(places[t + 1, 0] - places[t, 0], places[t + 1, 1] - places[t, 1])
        travelled[t + 1] = travelled[t] + step
    until = min(braking_time, speed / braking)
    instant = 0
    for t in range(count):
        time = (t + 1) * STEP_S
        braked = min(time, until)
        reach = speed * braked - 0.5 * braking * braked**2 + (speed - braking * until) * (time - braked)
        if reach >= travelled[t + 1]:
            continue
        while travelled[instant + 1] < reach:  # reach grows from step to step
            instant += 1
        way = travelled[instant + 1] - travelled[instant]
        share = (reach - travelled[instant]) / way if way > 0.0 else 0.0  # 0 if it is forecast to stand
        states[t, X] = places[instant, 0] + share * (places[instant + 1, 0] - places[instant, 0])
        states[t, Y] = places[instant, 1] + share * (places[instant + 1, 1] - places[instant, 1])


@kernel
def gone_straight_on(speed: float, acceleration: float, time: float) -> float:
    """Distance [m] of an agent after `time` [s] that keeps its acceleration [m/s2] until it stands."""
    if acceleration < 0.0:
        time = min(time, -speed / acceleration)
    return speed * time + 0.5 * acceleration * time**2


@kernel
def _gone(speed: float, acceleration: float, hold: float, time: float) -> float:
    """Distance [m] of an agent after `time` [s] that keeps its acceleration for `hold` [s], and then its speed."""
    until = min(hold, time)
    if acceleration < 0.0:
        until = min(until, -speed / acceleration)
    later = max(speed + acceleration * until, 0.0)
    rest = time - until if not (acceleration < 0.0 and later <= 0.0) else 0.0
    return speed * until + 0.5 * acceleration * until**2 + later * rest


@kernel
def go_as_planned(
    paths: PathBatch,
    rows: Ints,
    fresh: Bools,
    agents: AgentArrays,
    sigma_scale: float,
    states: OutFloats3,
    valid: OutBools2,
) -> None:
    """Let r of n agents go along their `paths`, in place of their forecasts in `states` (n, T, 6) and `valid` (n, T).

    They are in `rows` (r,). Forecasts give their progress where they are valid: of those `fresh` (r,), whose policy has
    not acted yet, from now on. The motion of a fresh agent is valid only where its forecast is. It has one mode, whose
    standard deviations are multiplied by `sigma_scale`.
    """
    count = states.shape[1]
    kept, along, across = np.empty(count), np.empty(count), np.empty(count)  # of an offset; variances
    for t in range(count):
        time = (t + 1) * STEP_S
        kept[t] = math.exp(-time / SETTLE)
        along[t] = (sigma_scale * (SIGMA_START + ALONG_LINEAR * time + ALONG_QUADRATIC * time**2)) ** 2
        across[t] = (sigma_scale * (SIGMA_START + ACROSS_LINEAR * time)) ** 2
    for k in range(len(rows)):
        row, motion, known = rows[k], states[rows[k]], valid[rows[k]]
        speed, acceleration = agents.speed[row], agents.acceleration[row]
        hold, fade = (0.0, STEP_S) if fresh[k] else (HOLD, FADE)
        at_x, at_y, travelled = agents.x[row], agents.y[row], 0.0
        _, s_now, d_now = nearest(paths, k, at_x, at_y)
        for t in range(count):
            travelled += math.hypot(motion[t, X] - at_x, motion[t, Y] - at_y)
            at_x, at_y = motion[t, X], motion[t, Y]
            time = (t + 1) * STEP_S
            gone = _gone(speed, acceleration, hold, time)
            if known[t]:
                share = min(max(1.0 - (time - hold) / fade, 0.0), 1.0)
                gone = share * gone + (1.0 - share) * travelled
            on_x, on_y, ux, uy = place_at(paths, k, s_now + gone)
            d = d_now * kept[t]
            motion[t, X], motion[t, Y] = on_x - d * uy, on_y + d * ux
            motion[t, YAW] = math.atan2(uy, ux)
            motion[t, XX] = along[t] * ux**2 + across[t] * uy**2
            motion[t, YY] = along[t] * uy**2 + across[t] * ux**2
            motion[t, XY] = (along[t] - across[t]) * ux * uy
            known[t] |= not fresh[k]
