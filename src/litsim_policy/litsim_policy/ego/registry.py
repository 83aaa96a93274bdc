"""Egos that come with LitSim; any other stack can take their place on the ego port."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

from litsim_policy.ego.bat import BatConfig, BatEgo
from litsim_policy.ego.idm import CAREFUL, IdmEgo
from litsim_policy.ego.log import LogEgo
from litsim_policy.ego.perturbed import PerturbedConfig, PerturbedEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.scenario.scenario import Scenario


class Ego(Protocol):
    """Called once a step, in order."""

    def plan(self, table: AgentTable) -> EgoCommand:
        """The ego's answer to the step of `table`."""


def make_ego(
    name: str,
    scenario: Scenario,
    idm: IdmConfig = CAREFUL,
    perturbed: PerturbedConfig | None = None,
    bat: BatConfig | None = None,
) -> Ego:
    """The ego called `name`, for a run of `scenario`; `idm`, `perturbed` and `bat` are the parameters of those names.

    Raises:
        InputError: there is none of that name.
    """
    if name == "log":
        return LogEgo()
    if name == "idm":
        return IdmEgo(scenario, idm)
    if name == "perturbed":
        return PerturbedEgo(scenario, perturbed)
    if name == "bat":
        return BatEgo(scenario, bat)
    raise InputError(f"ego: {name!r} is unknown, expected bat, idm, log or perturbed")


def ego_stage(name: str, read: ParameterReader) -> Callable[[Scenario], Ego]:
    """Read the parameters of the ego called `name`; the result builds it once the run is known."""
    idm = read(CAREFUL) if name == "idm" else CAREFUL
    perturbed = read(PerturbedConfig()) if name == "perturbed" else None
    bat = read(BatConfig()) if name == "bat" else None
    return lambda scenario: make_ego(name, scenario, idm, perturbed, bat)


bat_stage, idm_stage = partial(ego_stage, "bat"), partial(ego_stage, "idm")
log_stage, perturbed_stage = partial(ego_stage, "log"), partial(ego_stage, "perturbed")
