"""The ego stage for the egos that come with LitSim: agent states in, ego control out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from litsim_msgs.msg import RunInfo

from litsim_policy.ego import Ego
from litsim_policy.stages import ego_stage
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
        self._make = ego_stage(name, partial(declare, self))
        self._run_id = ""
        self._ego: Ego

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """See :meth:`StageNode.configure`."""
        self._ego, self._run_id = self._make(scenario), info.run_id

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """See :meth:`StageNode.answer`."""
        return [ego_to_message(self._ego.plan(agents_from_message(inputs[AGENTS.name])), self._run_id)]
