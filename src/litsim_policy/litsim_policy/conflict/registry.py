"""The conflict stage by policy: conflict detection, or the region of the baselines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.region import RegionManager
from litsim_policy.conflict.takeover import TakeoverManager
from litsim_predictor.forecast import Forecast
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.policies import drives_by_region, drives_walkers
from litsim_sim.scenario.setting import Setting

TakeoverStage = TakeoverManager | RegionManager
"""What decides which agents are off their logs."""


class ForecastTakeovers(TakeoverManager):
    """Takeovers by conflicts for a policy that is given no forecasts unless they are asked for."""

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:
        """See :meth:`.takeover.TakeoverManager.update`.

        Raises:
            InputError: there are no forecasts.
        """
        is_driven = table.step >= self._scenario.history_steps and table.mask(self._scenario.ego_ids).any()
        if is_driven and not len(forecast.id):
            raise InputError(
                "conflict: parameter baselines is conflict, which needs forecasts of the ego; expected the parameter "
                "forecast_all of the predictor to be true"
            )
        return super().update(table, forecast)


def conflict_stage(read: ParameterOverrides) -> Callable[[str, Setting], TakeoverStage]:
    """Read the parameters of the conflict stage; the result makes its core for a policy and a scenario."""
    config = read(ConflictConfig())

    def build(policy: str, scenario: Setting) -> TakeoverStage:
        if not drives_by_region(policy):
            return TakeoverManager(scenario, config if drives_walkers(policy) else replace(config, walkers=False))
        if config.baselines == "conflict":
            return ForecastTakeovers(scenario, config)
        return RegionManager(scenario, np.inf if config.baselines == "all" else config.roi_m)

    return build
