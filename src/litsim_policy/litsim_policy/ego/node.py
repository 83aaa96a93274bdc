"""The ego node for LitSim's own egos: agent states in, ego control out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.ego.registry import Ego, ego_stage
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.ros.messages import ego_to_message, received_agents
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.stage import StageNode, run_stages
from litsim_sim.ros.topics import AGENTS, EGO_CONTROL
from litsim_sim.scenario.scenario import Scenario


class EgoNode(StageNode):
    """Drives the ego by the driver called `name` in :mod:`.registry`."""

    stage = "ego"
    inputs = ((AGENTS, received_agents),)
    outputs = ((EGO_CONTROL, ego_to_message),)

    def __init__(self, name: str, transport: InProcessTransport | None = None) -> None:
        super().__init__(transport)
        self._make = read_parameters(self, partial(ego_stage, name))
        self._ego: Ego

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        del info
        self._ego = self._make(scenario)

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [self._ego.plan(inputs[AGENTS.name])]


def run_bat() -> None:
    """Entry point of ``ros2 run litsim_policy ego_bat``."""
    run_stages(partial(EgoNode, "bat"))


def run_idm() -> None:
    """Entry point of ``ros2 run litsim_policy ego_idm``."""
    run_stages(partial(EgoNode, "idm"))


def run_log() -> None:
    """Entry point of ``ros2 run litsim_policy ego_log``."""
    run_stages(partial(EgoNode, "log"))


def run_perturbed() -> None:
    """Entry point of ``ros2 run litsim_policy ego_perturbed``."""
    run_stages(partial(EgoNode, "perturbed"))
