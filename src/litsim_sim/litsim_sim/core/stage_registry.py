"""The stages that the installed packages have, and their parameters checked before a run begins.

A package registers each of its stages as an entry point of :data:`GROUP`: a function that reads the stage's
configurations with the :class:`~litsim_sim.core.parameters.ParameterReader` that it is given, and returns what builds
the stage once the scenario is known. So the launcher, which may not import the packages above it, checks parameters
with the functions that the nodes and the in-process runner use.
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
    """The name under which a stage is registered, and that of its executable: the ego's depends on who drives it."""
    return f"ego_{ego}" if stage == EGO else stage


def configured(stages: Mapping[str, str], parameters: Parameters) -> dict[str, Any]:
    """Read the parameters of the stages of a run; returns by stage what its registered function has made of them.

    Args:
        stages: the stages of the run, and the name under which each is registered.
        parameters: what was given; what was not is at its default.

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
    """The stages of the installed packages by name; to find them, the metadata of all packages are read."""
    return {each.name: each for each in reversed(tuple(entry_points(group=GROUP)))}  # of two, the first
