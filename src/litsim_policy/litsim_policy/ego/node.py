"""The ego node for LitSim's own egos: agent states in, ego control out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.ego.ego import Ego
from litsim_sim.core.errors import InputError
from litsim_sim.core.stage_registry import stage_reader
from litsim_sim.core.stages import EGO
from litsim_sim.launch.nodes import DRIVER
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.ros.messages import ego_to_message, received_agents
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.stage import StageNode, run_stages
from litsim_sim.ros.topics import AGENTS, EGO_CONTROL
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.scenario import Scenario


class EgoNode(StageNode):
    """Drives the ego by the installed driver that its parameter ``driver`` names."""

    stage = EGO
    inputs = ((AGENTS, received_agents),)
    outputs = ((EGO_CONTROL, ego_to_message),)

    def __init__(self, transport: InProcessTransport | None = None) -> None:
        super().__init__(transport)
        self.driver = "idm"
        if self.has_parameter(DRIVER):
            self.driver = self.get_parameter(DRIVER).value
            self.undeclare_parameter(DRIVER)  # not one of the driver's own, which a rerun reads from the record
        self._make = read_parameters(self, stage_reader(EGO, self.driver))
        self._ego: Ego
        self._perception: Perception

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        if info.ego != self.driver:
            raise InputError(
                f"the run's ego is {info.ego}, but this node drives as {self.driver}: set driver:={info.ego}"
            )
        self._ego, self._perception = self._make(scenario), Perception(scenario)

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [self._ego.plan(self._perception.of(inputs[AGENTS.name]))]


def main() -> None:
    """Entry point of ``ros2 run litsim_policy ego``."""
    run_stages(EgoNode)


if __name__ == "__main__":
    main()
