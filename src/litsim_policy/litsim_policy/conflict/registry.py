"""The conflict stage by policy, which decides which agents are off their logs at each step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from litsim_policy.conflict.detection import ConflictConfig
from litsim_policy.conflict.region import RegionManager
from litsim_policy.conflict.takeover import TakeoverConfig, TakeoverManager
from litsim_predictor.forecast import Forecast
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.scene import AgentTable, BoolArray, IntArray
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.run_info import BASELINES
from litsim_sim.scenario.setting import Setting


class TakeoverStage(Protocol):
    """Called once a step, in order.

    Attributes:
        iterations, converged: (scenes,) of the last update, as :class:`TakeoverTable` has them.
    """

    iterations: IntArray
    converged: BoolArray

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:
        """The agents off their logs at this step, and why."""


def conflict_stage(read: ParameterReader) -> Callable[[str, Setting], TakeoverStage]:
    """Read the parameters of the conflict stage; the result builds its core for a policy and a scenario."""
    conflict, takeover = read(ConflictConfig()), read(TakeoverConfig())

    def build(policy: str, scenario: Setting) -> TakeoverStage:
        return (
            RegionManager(scenario, conflict.roi_m)
            if policy in BASELINES
            else TakeoverManager(scenario, conflict, takeover)
        )

    return build
