"""The policy `simnet`, without the imports of its code, which runs with other policies do not need."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from litsim_policy.driving.policy import Policy
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.setting import Setting

SHIPPED = Path(str(resources.files("litsim_research").joinpath("weights/simnet.safetensors")))
"""The packaged weights."""


@configuration
class SimnetConfig:
    """Which network drives.

    Attributes:
        weights: file of the network; empty for the packaged one.
    """

    weights: str = ""


class Simnet(Policy):
    """The policy called `simnet`, see :class:`litsim_research.baselines.simnet.policy.SimnetPolicy`."""

    defaults, prefix = SimnetConfig(), "simnet."
    by_region = batched = True

    def __init__(self, scenario: Setting, config: SimnetConfig) -> None:
        from litsim_research.baselines.simnet.network import load_network
        from litsim_research.baselines.simnet.policy import SimnetPolicy

        self._policy = SimnetPolicy(scenario, load_network(Path(config.weights) if config.weights else SHIPPED))

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        return self._policy.act(table, takeovers)
