"""The ego node for LitSim's own egos: agent states in, ego control out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.ego.ego import Ego
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.plugins import stage_reader
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.core.stages import EGO
from litsim_sim.launch.nodes import DRIVER
from litsim_sim.ros.messages import ego_to_message, received_agents
from litsim_sim.ros.stage import StageNode
from litsim_sim.ros.topics import AGENTS, EGO_CONTROL
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.scenario import Scenario


class EgoNode(StageNode):
    """Drives the ego by the installed driver that its parameter ``driver`` names."""

    stage = EGO
    inputs = ((AGENTS, received_agents),)
    output = (EGO_CONTROL, ego_to_message)

    def reader(self) -> Callable[[ParameterOverrides], Callable[..., Any]]:
        """See :meth:`StageNode.reader`."""
        self.driver = "idm"
        if self.has_parameter(DRIVER):
            self.driver = self.get_parameter(DRIVER).value
            self.undeclare_parameter(DRIVER)  # not one of the driver's own, which a rerun reads from the record
        return stage_reader(EGO, self.driver)

    def configure(self, info: RunInfo, scenario: Scenario) -> tuple[Ego, Perception]:
        """See :meth:`StageNode.configure`."""
        if info.ego != self.driver:
            raise InputError(
                f"the run's ego is {info.ego}, but this node drives as {self.driver}: set driver:={info.ego}"
            )
        return self._make(scenario), Perception(scenario)

    def answer(self, core: tuple[Ego, Perception], agents: AgentTable) -> EgoCommand:
        """See :meth:`StageNode.answer`."""
        ego, perception = core
        return ego.plan(perception.of(agents))
