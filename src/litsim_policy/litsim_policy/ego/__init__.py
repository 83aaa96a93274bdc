"""Egos that come with LitSim; any other stack can take their place on the ego port."""

from __future__ import annotations

from typing import Protocol

from litsim_policy.car_following import IdmConfig
from litsim_policy.ego.idm import CAREFUL, IdmEgo
from litsim_policy.ego.log import LogEgo
from litsim_sim.errors import InputError
from litsim_sim.scenario import Scenario
from litsim_sim.scene import AgentTable, EgoCommand


class Ego(Protocol):
    """Called once a step, in order."""

    def plan(self, table: AgentTable) -> EgoCommand:
        """The ego's answer to the step of `table`."""


def make_ego(name: str, scenario: Scenario, idm: IdmConfig = CAREFUL) -> Ego:
    """The ego called `name`, for a run of `scenario`; `idm` are the parameters of the ego of that name.

    Raises:
        InputError: there is none of that name.
    """
    if name == "log":
        return LogEgo()
    if name == "idm":
        return IdmEgo(scenario, idm)
    raise InputError(f"ego: {name!r} is unknown, expected idm or log")
