"""Futures of agents under control, along the paths that they were given.

For other agents, a predictor estimates path and speed. For an agent under control, the path and the current command of
its policy are known. Its later progress along the path is left to the forecast, which considers the agents ahead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from litsim_policy.conflict.futures import XX, XY, YAW, YY, PredictedMotion, X, Y
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.path_kernels import UNIT_X, UNIT_Y, S, nearest, segment_at
from litsim_sim.core.quantities import Acceleration, Duration, Flag, Length, NonNegative, Positive, Speed, configuration
from litsim_sim.core.quickly_made import quickly_made
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import BOOLS2, FLOATS, FLOATS3, INTS, OUT_FLOATS3, float64, kernel


@configuration
class IntentConfig:
    """How an agent under control is assumed to continue.

    Attributes:
        used: whether it is expected on its path; otherwise it is forecast as other agents are.
        hold: time for which it keeps its acceleration; after that, it keeps its speed.
        fade: time, after `hold`, within which the forecast's progress along the path takes over.
        settle: time constant of its return to the path.
        sigma_along, sigma_across: growth of the standard deviations, linear and quadratic terms.
        sigma_start: standard deviation at the start.
    """

    used: Flag = True
    hold: NonNegative[Duration] = 1.0
    fade: Positive[Duration] = 2.0
    settle: Positive[Duration] = 1.0
    sigma_along: tuple[NonNegative[Speed], NonNegative[Acceleration]] = (0.05, 0.25)
    sigma_across: tuple[NonNegative[Speed], NonNegative[Acceleration]] = (0.03, 0.0)
    sigma_start: NonNegative[Length] = 0.1


@quickly_made
@dataclass(frozen=True)
class Intents:
    """The agents under control at a step, rows ascending, and their paths; see :func:`intended_motion`.

    Attributes:
        rows: (r,) in the table.
        paths: of these agents.
        fresh: (r,) whether the agent was taken over in this very step, so that its policy has not acted yet.
    """

    rows: IntArray
    paths: PathBatch
    fresh: BoolArray

    def among(self, agents: BoolArray) -> Intents:
        """The intents of the agents in the mask `agents` (n,)."""
        mine = agents[self.rows]
        if mine.all():
            return self
        kept = mine.nonzero()[0]
        return Intents(self.rows[kept], self.paths.take(kept), self.fresh[kept])

    def moved_to(self, rows: IntArray) -> Intents:
        """The same for a table made of the `rows` (k,), ascending, which include all of these agents."""
        return Intents(rows.searchsorted(self.rows), self.paths, self.fresh)


def intended_motion(
    config: IntentConfig, intents: Intents, table: AgentTable, forecast: PredictedMotion, sigma_scale: float
) -> PredictedMotion:
    """The motion of the agents (r,) of `intents` along their reference paths; it has one mode.

    Args:
        config: how they are assumed to continue.
        intents: the agents under control, and their paths.
        table: all agents.
        forecast: of the agents (r,), by a predictor; ignored where it is not valid. The motion of a fresh agent is
            valid only where its forecast is.
        sigma_scale: factor on the standard deviations.
    """
    rows = intents.rows
    states = _along(
        intents.paths.segments,
        intents.paths.circles,
        intents.paths.count,
        table.x[rows],
        table.y[rows],
        table.speed[rows],
        table.acceleration[rows],
        forecast.states,
        forecast.valid,
        np.where(intents.fresh, 0.0, config.hold),
        np.where(intents.fresh, STEP_S, config.fade),
        config.settle,
        sigma_scale * config.sigma_start,
        sigma_scale * config.sigma_along[0],
        sigma_scale * config.sigma_along[1],
        sigma_scale * config.sigma_across[0],
        sigma_scale * config.sigma_across[1],
    )
    return PredictedMotion(states, forecast.valid | ~intents.fresh[:, None])


@kernel(float64(*[float64] * 4))
def _gone(speed: float, acceleration: float, hold: float, time: float) -> float:
    """Distance [m] of an agent after `time` [s] that keeps its acceleration for `hold` [s], and then its speed."""
    until = min(hold, time)
    if acceleration < 0.0:
        until = min(until, -speed / acceleration)
    later = max(speed + acceleration * until, 0.0)
    rest = time - until if not (acceleration < 0.0 and later <= 0.0) else 0.0
    return speed * until + 0.5 * acceleration * until**2 + later * rest


@kernel(OUT_FLOATS3(FLOATS3, FLOATS3, INTS, *[FLOATS] * 4, FLOATS3, BOOLS2, FLOATS, FLOATS, *[float64] * 6))
def _along(  # noqa: PLR0917 - a kernel takes arrays and numbers
    segments: FloatArray,
    circles: FloatArray,
    count: IntArray,
    x: FloatArray,
    y: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    forecast: FloatArray,
    valid: BoolArray,
    hold: FloatArray,
    fade: FloatArray,
    settle: float,
    sigma_start: float,
    along_1: float,
    along_2: float,
    across_1: float,
    across_2: float,
) -> FloatArray:
    """Return `states` (r, T, 6); see :func:`intended_motion`.

    Args:
        segments, circles, count: of the paths; see :mod:`litsim_policy.motion.path_kernels`.
        x, y, speed, acceleration: (r,) of the agents now.
        forecast, valid: (r, T, 6), (r, T) of the agents by a predictor, for their progress.
        hold, fade: (r,) as in :class:`IntentConfig`.
        settle, sigma_start: likewise.
        along_1, along_2, across_1, across_2: terms of the standard deviations.
    """
    states = np.zeros(forecast.shape)
    for k in range(len(count)):
        _, s_now, d_now = nearest(segments[k], circles[k], count[k], x[k], y[k])
        at_x, at_y, travelled = x[k], y[k], 0.0
        for t in range(forecast.shape[1]):
            travelled += math.hypot(forecast[k, t, X] - at_x, forecast[k, t, Y] - at_y)
            at_x, at_y = forecast[k, t, X], forecast[k, t, Y]
            time = (t + 1) * STEP_S
            gone = _gone(speed[k], acceleration[k], hold[k], time)
            if valid[k, t]:
                known = min(max(1.0 - (time - hold[k]) / fade[k], 0.0), 1.0)
                gone = known * gone + (1.0 - known) * travelled
            s = s_now + gone
            at = segment_at(segments, count[k], k, s)
            ux, uy = segments[k, at, UNIT_X], segments[k, at, UNIT_Y]
            forward, d = s - segments[k, at, S], d_now * math.exp(-time / settle)
            states[k, t, X] = segments[k, at, 0] + forward * ux - d * uy
            states[k, t, Y] = segments[k, at, 1] + forward * uy + d * ux
            states[k, t, YAW] = math.atan2(uy, ux)
            along = (sigma_start + along_1 * time + along_2 * time**2) ** 2
            across = (sigma_start + across_1 * time + across_2 * time**2) ** 2
            states[k, t, XX] = along * ux**2 + across * uy**2
            states[k, t, YY] = along * uy**2 + across * ux**2
            states[k, t, XY] = (along - across) * ux * uy
    return states
