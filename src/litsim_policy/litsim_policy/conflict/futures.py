"""Futures of agents, by their logs or by forecast; compiled loops over agents and steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numba import types

from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.quickly_made import quickly_made
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    BOOLS,
    BOOLS2,
    FLOATS,
    FLOATS2,
    FLOATS3,
    INTS,
    OUT_BOOLS2,
    OUT_FLOATS2,
    OUT_FLOATS3,
    float64,
    int64,
    kernel,
    read_array,
    void,
)

X, Y, YAW, XX, YY, XY = range(6)  # columns of `PredictedMotion.states`
LOW_X, LOW_Y, HIGH_X, HIGH_Y, SPREAD = range(5)  # columns of `PredictedMotion.bounds`
ROUNDING = 1e-9  # share of a step by which an instant of a forecast may differ from a step that it falls on

_SINGLES2, _SINGLES3 = read_array(types.float32, 2), read_array(types.float32, 3)


@quickly_made
@dataclass(frozen=True)
class OtherMotions:
    """q alternative motions of some of n agents.

    Attributes:
        row: (q,) of the agent.
        weight: (q,) probability of the motion; the first motion of an agent has the remainder to 1.
        states, valid: (q, T, 6), (q, T), as in :class:`PredictedMotion`.
    """

    row: IntArray
    weight: FloatArray
    states: FloatArray
    valid: BoolArray

    @classmethod
    def none(cls, steps: int = 0) -> OtherMotions:
        """Return no alternative motions, for futures of T = `steps`."""
        return cls(np.empty(0, np.int64), np.empty(0), np.empty((0, steps, 6)), np.empty((0, steps), np.bool_))

    def __len__(self) -> int:
        return len(self.row)

    @cached_property
    def bounds(self) -> FloatArray:
        """Bounds (q, 5) of the motions, as in :class:`PredictedMotion`."""
        return bounds(self.states, self.valid)


@quickly_made
@dataclass(frozen=True)
class PredictedMotion:
    """Boxes of n agents at T future steps of 0.1 s, the first of them 0.1 s ahead.

    Attributes:
        states: (n, T, 6) x, y [m], yaw [rad] and covariance xx, yy, xy [m2] of the centre, frame map.
        valid: (n, T) whether the agent is known to be on the road then.
        others: alternative motions.
    """

    states: FloatArray
    valid: BoolArray
    others: OtherMotions = field(default_factory=OtherMotions.none)

    @property
    def x(self) -> FloatArray:
        """Coordinate x (n, T) of the centre [m]."""
        return self.states[..., X]

    @property
    def y(self) -> FloatArray:
        """Coordinate y (n, T) of the centre [m]."""
        return self.states[..., Y]

    @property
    def yaw(self) -> FloatArray:
        """Heading (n, T) [rad]."""
        return self.states[..., YAW]

    @property
    def covariance(self) -> FloatArray:
        """Covariance (n, T, 3) xx, yy, xy of the centre [m2]."""
        return self.states[..., XX:]

    @cached_property
    def bounds(self) -> FloatArray:
        """Bounds (n, 5): least x, y, greatest x, y of the centre over valid steps [m], and the largest spread [m].

        Without valid steps the former are inf and -inf. The spread is the root of the sum of both variances.
        """
        return bounds(self.states, self.valid)

    def put(self, rows: BoolArray, other: PredictedMotion) -> None:
        """Copy the motions of agents in the mask `rows` (n,), which have none yet, from `other`, in place.

        Call it before bounds are read.
        """
        at = rows.nonzero()[0]
        self.states[at], self.valid[at] = other.states[at], other.valid[at]


@kernel(OUT_FLOATS2(FLOATS3, BOOLS2))
def bounds(states: FloatArray, valid: BoolArray) -> FloatArray:
    """Return `PredictedMotion.bounds` (n, 5) of `states` (n, T, 6) while `valid` (n, T)."""
    found = np.empty((states.shape[0], 5))
    for k in range(states.shape[0]):
        found[k, LOW_X], found[k, LOW_Y], found[k, HIGH_X], found[k, HIGH_Y] = np.inf, np.inf, -np.inf, -np.inf
        variance = 0.0
        for t in range(states.shape[1]):
            variance = max(variance, states[k, t, XX] + states[k, t, YY])
            if valid[k, t]:
                x, y = states[k, t, X], states[k, t, Y]
                found[k, LOW_X], found[k, LOW_Y] = min(found[k, LOW_X], x), min(found[k, LOW_Y], y)
                found[k, HIGH_X], found[k, HIGH_Y] = max(found[k, HIGH_X], x), max(found[k, HIGH_Y], y)
        found[k, SPREAD] = math.sqrt(variance)
    return found


@kernel(OUT_FLOATS2(FLOATS2, INTS, FLOATS2, *[FLOATS] * 5))
def widest(
    bounds: FloatArray,
    row: IntArray,
    further: FloatArray,
    x: FloatArray,
    y: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    time: FloatArray,
) -> FloatArray:
    """Return bounds (n, 5) of all possible motions: first, alternative, and straight on for some time.

    Args:
        bounds: (n, 5) of their first motions.
        row, further: (q,), (q, 5) of their alternative motions: rows of the agents, and bounds.
        x, y, speed, acceleration: (n,) of the agents now [m], [m/s], [m/s2].
        time: (n,) for which they may continue straight on [s].
    """
    found = bounds.copy()
    for k in range(len(x)):
        reach = abs(speed[k]) * time[k] + 0.5 * abs(acceleration[k]) * time[k] ** 2
        found[k, LOW_X], found[k, LOW_Y] = min(found[k, LOW_X], x[k] - reach), min(found[k, LOW_Y], y[k] - reach)
        found[k, HIGH_X], found[k, HIGH_Y] = max(found[k, HIGH_X], x[k] + reach), max(found[k, HIGH_Y], y[k] + reach)
    for q in range(len(row)):
        k = row[q]
        for low in (LOW_X, LOW_Y):
            found[k, low] = min(found[k, low], further[q, low])
        for high in (HIGH_X, HIGH_Y, SPREAD):
            found[k, high] = max(found[k, high], further[q, high])
    return found


@kernel(
    types.Tuple((OUT_FLOATS3, OUT_BOOLS2))(FLOATS2, FLOATS2, FLOATS2, BOOLS2, INTS, INTS, int64, FLOATS, FLOATS, BOOLS)
)
def follow_logs(  # noqa: PLR0917 - a kernel takes arrays and numbers
    log_x: FloatArray,
    log_y: FloatArray,
    log_yaw: FloatArray,
    log_valid: BoolArray,
    rows: IntArray,
    now: IntArray,
    count: int,
    x: FloatArray,
    y: FloatArray,
    on_log: BoolArray,
) -> tuple[FloatArray, BoolArray]:
    """Return `states` (n, T, 6) and `valid` (n, T) of agents by their logs.

    Args:
        log_x, log_y, log_yaw, log_valid: (N, S) of the log [m], [rad].
        rows: (n,) of the agents in the log.
        now: (n,) present step of each agent's log.
        count: number T of steps.
        x, y: (n,) of the agents now [m].
        on_log: (n,) whether the agent follows its log, and keeps its residual.
    """
    last = log_x.shape[1] - 1
    states, valid = np.zeros((len(rows), count, 6)), np.zeros((len(rows), count), np.bool_)
    for k in range(len(rows)):
        row, here = rows[k], min(max(now[k], 0), last)
        off_x, off_y = 0.0, 0.0
        if on_log[k] and log_valid[row, here]:
            off_x, off_y = x[k] - log_x[row, here], y[k] - log_y[row, here]
        for t in range(count):
            step = now[k] + t + 1
            at = min(max(step, 0), last)
            states[k, t, X], states[k, t, Y] = log_x[row, at] + off_x, log_y[row, at] + off_y
            states[k, t, YAW] = log_yaw[row, at]
            valid[k, t] = step == at and log_valid[row, at]
    return states, valid


@kernel(
    types.Tuple((OUT_FLOATS3, OUT_BOOLS2))(
        FLOATS3, _SINGLES2, _SINGLES3, float64, INTS, int64, float64, FLOATS, FLOATS, FLOATS
    )
)
def interpolate(  # noqa: PLR0917 - a kernel takes arrays and numbers
    mean: FloatArray,
    yaw: FloatArray,
    sigmas: FloatArray,
    dt: float,
    rows: IntArray,
    count: int,
    sigma_scale: float,
    x_now: FloatArray,
    y_now: FloatArray,
    yaw_now: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """Return `states` (n, T, 6) and `valid` (n, T) of agents by forecast, linear between its instants.

    Args:
        mean, yaw, sigmas: (N, F, 2), (N, F), (N, F, 3) as in :class:`litsim_predictor.forecast.Forecast`.
        dt: between instants of the forecast [s].
        rows: (n,) of the agents in the forecast, -1 for agents without one.
        count: number T of steps.
        sigma_scale: factor on the standard deviations.
        x_now, y_now, yaw_now: (n,) of the agents now [m], [rad].
    """
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


@kernel(float64(float64, float64, float64))
def gone_straight_on(speed: float, acceleration: float, time: float) -> float:
    """Distance [m] of an agent after `time` [s] that keeps its acceleration [m/s2] until it stands."""
    if acceleration < 0.0:
        time = min(time, -speed / acceleration)
    return speed * time + 0.5 * acceleration * time**2


@kernel(void(OUT_FLOATS2, float64, float64, float64, float64, float64))
def hold_back(states: FloatArray, x: float, y: float, speed: float, braking: float, braking_time: float) -> None:
    """Limit a forecast, in place, to the distance that a vehicle covers if it continues to brake.

    Args:
        states: (T, 6) of one agent.
        x, y: present position [m].
        speed: present speed [m/s].
        braking: deceleration [m/s2].
        braking_time: for which it continues [s], unless it stands sooner.
    """
    count = len(states)
    places, travelled = np.empty((count + 1, 2)), np.zeros(count + 1)
    places[0, 0], places[0, 1] = x, y
    for t in range(count):
        places[t + 1, 0], places[t + 1, 1] = states[t, X], states[t, Y]
        step = math.hypot(places[t + 1, 0] - places[t, 0], places[t + 1, 1] - places[t, 1])
        travelled[t + 1] = travelled[t] + step
    until = min(braking_time, speed / braking)
    at = 0
    for t in range(count):
        time = (t + 1) * STEP_S
        braked = min(time, until)
        reach = speed * braked - 0.5 * braking * braked**2 + (speed - braking * until) * (time - braked)
        if reach >= travelled[t + 1]:
            continue
        while travelled[at + 1] < reach:  # reach grows from step to step
            at += 1
        way = travelled[at + 1] - travelled[at]
        share = (reach - travelled[at]) / way if way > 0.0 else 0.0  # 0 if it is forecast to stand
        states[t, X] = places[at, 0] + share * (places[at + 1, 0] - places[at, 0])
        states[t, Y] = places[at, 1] + share * (places[at + 1, 1] - places[at, 1])
