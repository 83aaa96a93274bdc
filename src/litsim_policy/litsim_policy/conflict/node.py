"""The conflict stage: agent states and forecasts in, takeovers out."""

from __future__ import annotations

from litsim_policy.conflict.messages import takeovers_to_message
from litsim_policy.conflict.registry import TakeoverStage
from litsim_predictor.forecast import Forecast
from litsim_predictor.ros.messages import received_forecast
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.stages import CONFLICT
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.ros.messages import received_agents
from litsim_sim.ros.stage import StageNode
from litsim_sim.ros.topics import AGENTS, FORECASTS, TAKEOVERS


class ConflictNode(StageNode):
    """Publishes at every step which agents are off their logs, and why."""

    stage = CONFLICT
    inputs = ((AGENTS, received_agents), (FORECASTS, received_forecast))
    output = (TAKEOVERS, takeovers_to_message)

    def answer(self, core: TakeoverStage, agents: AgentTable, forecast: Forecast) -> TakeoverTable:
        """See :meth:`StageNode.answer`."""
        return core.update(agents, forecast)
