"""The predictor `straight_on`: everybody keeps velocity and heading."""

from __future__ import annotations

import numpy as np

from litsim_predictor.forecast import Forecast, Modes, PredictorPlugin, Scope, selected
from litsim_sim.core.scene import AgentTable
from litsim_sim.scenario.setting import Setting

AHEAD = np.arange(0.2, 5.1, 0.2)  # [s] from the step on which the forecast is made


class StraightOn(PredictorPlugin):
    """Forecasts 5 s at constant velocity, with an error that grows by 0.5 m each second."""

    def __init__(self, scenario: Setting, scope: Scope) -> None:
        self._egos, self._scope = scenario.ego_ids, scope

    def observe(self, table: AgentTable) -> None:
        """Nothing is remembered from a step without a forecast."""

    def forecast(self, table: AgentTable) -> Forecast:
        """See :class:`litsim_predictor.forecast.Forecast`."""
        near, rows = selected(table, self._egos, self._scope.roi_m, self._scope.wanted)
        agents = near.take(rows)
        yaw = np.repeat(agents.yaw[:, None], len(AHEAD), axis=1)
        way = agents.speed[:, None] * AHEAD  # [m]
        mean = np.stack([agents.x[:, None] + way * np.cos(yaw), agents.y[:, None] + way * np.sin(yaw)], axis=-1)
        spread = np.zeros((*way.shape, 3), np.float32)
        spread[..., :2] = (0.1 + 0.5 * AHEAD)[:, None]  # [m] in x and y, uncorrelated
        nothing, valid = np.empty((len(agents), 0), np.float32), np.ones(len(agents), np.bool_)
        modes = Modes.none(len(AHEAD))
        return Forecast(table.step, 0.2, agents.id, mean, yaw.astype(np.float32), spread, nothing, valid, modes)
