"""The ego stage for the egos that come with LitSim: agent states in, ego control out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.ego.registry import Ego, ego_stage
from litsim_sim.ros.messages import ego_to_message, received_agents
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.stage import StageNode, run_node
from litsim_sim.ros.topics import AGENTS, EGO_CONTROL
from litsim_sim.scenario.scenario import Scenario


class EgoNode(StageNode):
    """Drives the ego with the core called `name`."""

    stage = "ego"
    inputs = (AGENTS,)
    outputs = (EGO_CONTROL,)

    def __init__(self, name: str) -> None:
        super().__init__()
        self._make = read_parameters(self, partial(ego_stage, name))
        self._run_id = ""
        self._ego: Ego

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        self._ego, self._run_id = self._make(scenario), info.run_id

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [ego_to_message(self._ego.plan(received_agents(inputs[AGENTS.name])), self._run_id)]


def run_bat() -> None:
    """Entry point of ``ros2 run litsim_policy ego_bat``."""
    run_node(lambda: EgoNode("bat"))


def run_idm() -> None:
    """Entry point of ``ros2 run litsim_policy ego_idm``."""
    run_node(lambda: EgoNode("idm"))


def run_log() -> None:
    """Entry point of ``ros2 run litsim_policy ego_log``."""
    run_node(lambda: EgoNode("log"))


def run_perturbed() -> None:
    """Entry point of ``ros2 run litsim_policy ego_perturbed``."""
    run_node(lambda: EgoNode("perturbed"))
