"""The plug-in of the policy `simnet`, without the imports of its code, which runs with other policies do not need."""

from __future__ import annotations

from litsim_policy.driving.policy import Policy
from litsim_research.baselines.simnet.config import SimnetConfig
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.setting import Setting


class Simnet(Policy):
    """The policy called `simnet`, see :class:`litsim_research.baselines.simnet.policy.SimnetPolicy`."""

    defaults, prefix = SimnetConfig(), "simnet."
    by_region = batched = True

    def __init__(self, scenario: Setting, config: SimnetConfig) -> None:
        from litsim_research.baselines.simnet.network import load_network
        from litsim_research.baselines.simnet.policy import SimnetPolicy

        self._policy = SimnetPolicy(scenario, load_network(config.file()))

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        return self._policy.act(table, takeovers)
