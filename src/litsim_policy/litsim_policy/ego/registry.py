"""The ego drivers of LitSim by name, and their parameters."""

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
    """A driver of the ego."""

    def plan(self, table: AgentTable) -> EgoCommand:
        """Returns the command for the step of `table`; called once per step, in order."""


def make_ego(
    name: str,
    scenario: Scenario,
    idm: IdmConfig = CAREFUL,
    perturbed: PerturbedConfig | None = None,
    bat: BatConfig | None = None,
) -> Ego:
    """The ego called `name`, for a run of `scenario`; `idm`, `perturbed` and `bat` are parameters of those egos.

    Raises:
        InputError: the name is unknown.
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
    """Read the parameters of the ego called `name`; the result makes the ego for a scenario."""
    idm = read(CAREFUL) if name == "idm" else CAREFUL
    perturbed = read(PerturbedConfig()) if name == "perturbed" else None
    bat = read(BatConfig()) if name == "bat" else None
    return lambda scenario: make_ego(name, scenario, idm, perturbed, bat)


bat_stage, idm_stage = partial(ego_stage, "bat"), partial(ego_stage, "idm")
log_stage, perturbed_stage = partial(ego_stage, "log"), partial(ego_stage, "perturbed")
