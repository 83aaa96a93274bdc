"""Constant turn rate and velocity, for every agent on its own."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from litsim_predictor.forecast import DT_MIN_S, Forecast, Modes, PredictorPlugin, Scope, selected
from litsim_sim.core.history import History
from litsim_sim.core.quantities import Duration, Horizon, at_most, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray
from litsim_sim.scenario.setting import Setting

RATE_WINDOW = 10  # [steps] over which the turn rate is averaged: recorded headings are noisy
RATE_DEAD_BAND = 0.03  # [rad/s] turn rates below are noise, and count as none
RATE_DECAY = 1.5  # [s] time constant with which drivers are expected to end a turn
SIGMA_START = 0.1  # [m] standard deviation at the start
SIGMA_ALONG, SIGMA_ACROSS = (0.55, 0.16), (0.15, 0.02)
"""Linear and quadratic growth [m/s], [m/s2] of the standard deviations, after the published error of constant velocity
on NGSIM, 0.7 m at 1 s to 6.7 m at 5 s."""


@configuration
class KinematicConfig:
    """Parameters of :class:`KinematicPredictor`.

    Attributes:
        horizon: time that a forecast covers.
        dt: time between its steps.
    """

    horizon: Horizon = 5.0
    dt: Annotated[Duration, Field(ge=DT_MIN_S)] = 0.2

    @model_validator(mode="after")
    def _has_a_step(self) -> Self:
        at_most(self, "dt", "horizon")
        return self


class KinematicPredictor(PredictorPlugin):
    """The predictor called `kinematic`: needs no training, uses at most the last second of history."""

    defaults, prefix = KinematicConfig(), "kinematic."
    batched = True

    def __init__(self, scenario: Setting, scope: Scope, config: KinematicConfig) -> None:
        self._ego_ids, self._scope, self._config = scenario.ego_ids, scope, config
        self._history = History(RATE_WINDOW + 1, ["yaw"])

    def observe(self, table: AgentTable) -> None:
        """See :class:`litsim_predictor.forecast.Predictor`."""
        self._history.push(table)

    def forecast(self, table: AgentTable) -> Forecast:
        """Forecast those that are wanted of `table`; see :class:`litsim_predictor.forecast.Forecast`."""
        config = self._config
        self.observe(table)
        interesting, rows = selected(table, self._ego_ids, self._scope.roi_m, self._scope.wanted)
        agents = interesting.take(rows)
        steps = round(config.horizon / config.dt)
        t: FloatArray = config.dt * np.arange(1, steps + 1, dtype=np.float64)
        rate = self._turn_rate(agents)
        yaw, way = roll_out(agents.yaw, agents.speed, rate, t)
        mean = np.stack([agents.x, agents.y], axis=-1)[:, None] + way
        return Forecast(
            step=table.step,
            dt=config.dt,
            id=agents.id,
            mean=mean,
            yaw=yaw.astype(np.float32),
            covariance=spread(yaw, t).astype(np.float32),
            maneuver_probability=np.empty((len(agents), 0), np.float32),
            valid=np.ones(len(agents), np.bool_),
            modes=Modes.none(steps),
        )

    def _turn_rate(self, agents: AgentTable) -> FloatArray:
        """Returns the mean turn rate (n,) [rad/s]; zero for agents that have just appeared or hardly turn."""
        yaws, present = self._history.window(agents.id, RATE_WINDOW + 1)
        yaw = yaws[..., 0]
        first = np.argmax(present, axis=1)
        span = (yaw.shape[1] - 1 - first) * STEP_S
        turned = np.arctan2(
            np.sin(yaw[:, -1] - yaw[np.arange(len(yaw)), first]), np.cos(yaw[:, -1] - yaw[np.arange(len(yaw)), first])
        )
        rate = np.divide(turned, span, out=np.zeros(len(yaw)), where=span > 0.5 * RATE_WINDOW * STEP_S)
        return np.where(np.abs(rate) > RATE_DEAD_BAND, rate, 0.0)


def roll_out(yaw: FloatArray, speed: FloatArray, rate: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns headings (..., T) [rad] and displacements (..., T, 2) [m] at times `t` (T,), multiples of the first.

    The `rate` (...) of turn [rad/s] decays.
    """
    yaws = yaw[..., None] + rate[..., None] * RATE_DECAY * (1.0 - np.exp(-t / RATE_DECAY))
    middle = np.concatenate([yaw[..., None], yaws], axis=-1)
    middle = 0.5 * (middle[..., 1:] + middle[..., :-1])
    distance = (speed * t[0])[..., None]
    way = np.stack([np.cumsum(distance * np.cos(middle), axis=-1), np.cumsum(distance * np.sin(middle), axis=-1)], -1)
    return yaws, way


def spread(yaw: FloatArray, t: FloatArray) -> FloatArray:
    """Returns the standard deviations along x and y [m] and the correlation (..., T, 3) of forecasts at `t` (T,) [s].

    They grow along and across the headings `yaw` (..., T) [rad], and are given in the axes in which the headings are.
    """
    along = (SIGMA_START + SIGMA_ALONG[0] * t + SIGMA_ALONG[1] * t**2) ** 2
    across = (SIGMA_START + SIGMA_ACROSS[0] * t + SIGMA_ACROSS[1] * t**2) ** 2
    cos, sin = np.cos(yaw), np.sin(yaw)
    xx, yy, xy = along * cos**2 + across * sin**2, along * sin**2 + across * cos**2, (along - across) * sin * cos
    return np.stack([np.sqrt(xx), np.sqrt(yy), xy / np.sqrt(xx * yy)], axis=-1)
