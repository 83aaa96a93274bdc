"""The policy stage: agent states and takeovers in, controls out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.conflict.messages import received_takeovers
from litsim_policy.driving.policy import Policy
from litsim_policy.driving.registry import policy_stage
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.ros.messages import controls_to_message, received_agents
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.stage import StageNode, run_stages
from litsim_sim.ros.topics import AGENTS, CONTROLS, TAKEOVERS
from litsim_sim.scenario.scenario import Scenario


class PolicyNode(StageNode):
    """Drives the agents that are taken over."""

    stage = "policy"
    inputs = ((AGENTS, received_agents), (TAKEOVERS, received_takeovers))
    outputs = ((CONTROLS, controls_to_message),)

    def __init__(self, transport: InProcessTransport | None = None) -> None:
        super().__init__(transport)
        self._make = read_parameters(self, policy_stage)
        self._policy: Policy

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        self._policy = self._make(info.policy, scenario)

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [self._policy.act(inputs[AGENTS.name], inputs[TAKEOVERS.name])]


def main() -> None:
    """Entry point of ``ros2 run litsim_policy policy``."""
    run_stages(PolicyNode)


if __name__ == "__main__":
    main()
