"""The predictor stage: agent states in, joint forecast out."""

from __future__ import annotations

from litsim_predictor.forecast import Forecast, Predictor
from litsim_predictor.ros.messages import forecast_to_message
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.stages import PREDICTOR
from litsim_sim.ros.messages import received_agents
from litsim_sim.ros.stage import StageNode
from litsim_sim.ros.topics import AGENTS, FORECASTS


class PredictorNode(StageNode):
    """Forecasts the agents of interest at every step."""

    stage = PREDICTOR
    inputs = ((AGENTS, received_agents),)
    output = (FORECASTS, forecast_to_message)

    def answer(self, core: Predictor, agents: AgentTable) -> Forecast:
        """See :meth:`StageNode.answer`."""
        return core.forecast(agents)
