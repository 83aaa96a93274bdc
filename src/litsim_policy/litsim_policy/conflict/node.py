"""The conflict stage: agent states and forecasts in, takeovers out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.conflict.messages import takeovers_to_message
from litsim_policy.conflict.registry import TakeoverStage, conflict_stage
from litsim_predictor.messages import received_forecast
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.ros.messages import received_agents
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.stage import StageNode, run_stages
from litsim_sim.ros.topics import AGENTS, FORECASTS, TAKEOVERS
from litsim_sim.scenario.scenario import Scenario


class ConflictNode(StageNode):
    """Publishes at every step which agents are off their logs, and why."""

    stage = "conflict"
    inputs = ((AGENTS, received_agents), (FORECASTS, received_forecast))
    outputs = ((TAKEOVERS, takeovers_to_message),)

    def __init__(self, transport: InProcessTransport | None = None) -> None:
        super().__init__(transport)
        self._make = read_parameters(self, conflict_stage)
        self._manager: TakeoverStage

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        self._manager = self._make(info.policy, scenario)

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [self._manager.update(inputs[AGENTS.name], inputs[FORECASTS.name])]


def main() -> None:
    """Entry point of ``ros2 run litsim_policy conflict``."""
    run_stages(ConflictNode)


if __name__ == "__main__":
    main()
