"""The policy stage: agent states and takeovers in, controls out."""

from __future__ import annotations

from litsim_policy.conflict.messages import received_takeovers
from litsim_policy.driving.policy import Policy
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.stages import POLICY
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.ros.messages import controls_to_message, received_agents
from litsim_sim.ros.stage import StageNode
from litsim_sim.ros.topics import AGENTS, CONTROLS, TAKEOVERS


class PolicyNode(StageNode):
    """Drives the agents that are taken over."""

    stage = POLICY
    inputs = ((AGENTS, received_agents), (TAKEOVERS, received_takeovers))
    output = (CONTROLS, controls_to_message)

    def answer(self, core: Policy, agents: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :meth:`StageNode.answer`."""
        return core.act(agents, takeovers)
