"""The predictor stage: agent states in, joint forecast out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_predictor.forecast import Predictor
from litsim_predictor.messages import forecast_to_message
from litsim_predictor.models import predictor_stage
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.ros.messages import received_agents
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.stage import StageNode, run_stages
from litsim_sim.ros.topics import AGENTS, FORECASTS
from litsim_sim.scenario.scenario import Scenario


class PredictorNode(StageNode):
    """Forecasts the agents of interest at every step."""

    stage = "predictor"
    inputs = ((AGENTS, received_agents),)
    outputs = ((FORECASTS, forecast_to_message),)

    def __init__(self, transport: InProcessTransport | None = None) -> None:
        super().__init__(transport)
        self._make = read_parameters(self, predictor_stage)
        self._predictor: Predictor

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        self._predictor = self._make(info.policy, scenario)

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [self._predictor.forecast(inputs[AGENTS.name])]


def main() -> None:
    """Entry point of ``ros2 run litsim_predictor predictor``."""
    run_stages(PredictorNode)


if __name__ == "__main__":
    main()
