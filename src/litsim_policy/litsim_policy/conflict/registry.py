"""The conflict stage by policy: conflict detection, or the region of the baselines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.region import RegionManager
from litsim_policy.conflict.takeover import TakeoverManager
from litsim_predictor.forecast import Forecast
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.scene import AgentTable, BoolArray, IntArray
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.run_info import drives_by_region
from litsim_sim.scenario.setting import Setting


class TakeoverStage(Protocol):
    """Decides which agents are off their logs.

    Attributes:
        iterations, converged: (scenes,) of the last update, as in :class:`TakeoverTable`.
    """

    iterations: IntArray
    converged: BoolArray

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:
        """Returns the agents off their logs at this step, and why; called once per step, in order."""


def conflict_stage(read: ParameterReader) -> Callable[[str, Setting], TakeoverStage]:
    """Read the parameters of the conflict stage; the result makes its core for a policy and a scenario."""
    config = read(ConflictConfig())

    def build(policy: str, scenario: Setting) -> TakeoverStage:
        if drives_by_region(policy):
            return RegionManager(scenario, config.roi_m)
        return TakeoverManager(scenario, config)

    return build
