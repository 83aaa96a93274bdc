"""The ego stage for the egos that come with LitSim: agent states in, ego control out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.ego import Ego, make_ego
from litsim_policy.ego.bat import BatConfig
from litsim_policy.ego.idm import CAREFUL
from litsim_policy.ego.perturbed import PerturbedConfig
from litsim_sim.ros.messages import agents_from_message, ego_to_message
from litsim_sim.ros.parameters import declare
from litsim_sim.ros.stage import StageNode
from litsim_sim.ros.topics import AGENTS, EGO_CONTROL
from litsim_sim.scenario import Scenario


class EgoNode(StageNode):
    """Drives the ego with the core called `name`."""

    stage = "ego"
    inputs = (AGENTS,)
    outputs = (EGO_CONTROL,)

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name, self._run_id = name, ""
        self._idm = declare(self, CAREFUL) if name == "idm" else CAREFUL
        self._perturbed = declare(self, PerturbedConfig()) if name == "perturbed" else None
        self._bat = declare(self, BatConfig()) if name == "bat" else None
        self._ego: Ego

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        self._ego, self._run_id = make_ego(self._name, scenario, self._idm, self._perturbed, self._bat), info.run_id

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [ego_to_message(self._ego.plan(agents_from_message(inputs[AGENTS.name])), self._run_id)]
