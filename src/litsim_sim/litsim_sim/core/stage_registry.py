"""Registry of the stages of installed packages, and the check of their parameters before a run.

A package registers each of its stages as an entry point of :data:`GROUP`: a function that reads the stage's
configurations with a :class:`~litsim_sim.core.parameters.ParameterReader`, and returns a factory of the stage for a
scenario. The launcher, which may not import the packages above it, thus checks parameters with the same functions as
the nodes and the in-process runner.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides, Parameters, not_among
from litsim_sim.core.stages import EGO

GROUP = "litsim.stages"


def registered_name(stage: str, ego: str) -> str:
    """Name under which a stage is registered, and name of its executable; that of the ego depends on its driver."""
    return f"ego_{ego}" if stage == EGO else stage


def configured(stages: Mapping[str, str], parameters: Parameters) -> dict[str, Any]:
    """Read the parameters of the stages of a run; return the result of each stage's registered function, by stage.

    Args:
        stages: names under which the stages of the run are registered, by stage.
        parameters: given parameters; others have their defaults.

    Raises:
        InputError: a stage takes no part in the run or is not installed; or a parameter is unknown or does not fit.
    """
    if absent := sorted(set(parameters) - set(stages)):
        raise InputError(f"no stage of this run: {not_among(absent, stages)}")
    made = {}
    for stage, name in stages.items():
        found = _registered().get(name)
        if found is None:
            raise InputError(f"no installed package has a stage {name}; build the workspace (make build)")
        read = ParameterOverrides(stage, parameters.get(stage, {}))
        made[stage] = found.load()(read)
        read.check()
    return made


@cache
def _registered() -> dict[str, EntryPoint]:
    """The stages of the installed packages, by name; cached, as it reads the metadata of all packages."""
    return {each.name: each for each in reversed(tuple(entry_points(group=GROUP)))}  # of duplicates, the first
