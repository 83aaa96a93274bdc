"""The predictor stage: agent states in, joint forecast out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_predictor.forecast import Predictor
from litsim_predictor.messages import forecast_to_message
from litsim_predictor.models import predictor_stage
from litsim_sim.ros.messages import received_agents
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.stage import StageNode, run_node
from litsim_sim.ros.topics import AGENTS, FORECASTS
from litsim_sim.scenario.scenario import Scenario


class PredictorNode(StageNode):
    """Forecasts the agents of interest at every step."""

    stage = "predictor"
    inputs = (AGENTS,)
    outputs = (FORECASTS,)

    def __init__(self) -> None:
        super().__init__()
        self._make = read_parameters(self, predictor_stage)
        self._run_id = ""
        self._predictor: Predictor

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        self._predictor, self._run_id = self._make(info.policy, scenario), info.run_id

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        forecast = self._predictor.forecast(received_agents(inputs[AGENTS.name]))
        return [forecast_to_message(forecast, self._run_id)]


def main() -> None:
    """Entry point of ``ros2 run litsim_predictor predictor``."""
    run_node(PredictorNode)


if __name__ == "__main__":
    main()
