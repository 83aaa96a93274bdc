"""The stages of installed packages, and the check of their parameters before a run.

A package registers each of its stages as an entry point of ``litsim.stages``: a function that reads the stage's
configurations with a :class:`~litsim_sim.core.parameters.ParameterOverrides`, and returns a factory of the stage for a
scenario. The ego's stage is that of its driver, a plug-in of ``litsim.egos``. The launcher, which imports no package
above its own, thus checks parameters with the same functions as the nodes and the in-process runner.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides, Parameters, not_among
from litsim_sim.core.stages import EGO


def stage_reader(stage: str, ego: str = "") -> Callable[[ParameterOverrides], Any]:
    """Returns the registered function of `stage`; of the ego's stage, that of the driver called `ego`.

    Raises:
        InputError: no installed package has it.
    """
    if stage == EGO:
        read: Callable[[ParameterOverrides], Any] = plugins.load(plugins.EGOS, ego).read
        return read
    if stage not in plugins.installed(plugins.STAGES):
        raise InputError(f"no installed package has a stage {stage}; build the workspace (make build)")
    registered: Callable[[ParameterOverrides], Any] = plugins.load(plugins.STAGES, stage)
    return registered


def configured(stages: Iterable[str], parameters: Parameters, ego: str = "") -> dict[str, Any]:
    """Read the parameters of the stages of a run; return the result of each stage's registered function, by stage.

    `ego` is the name of the ego's driver, if the ego is among the stages. Raises an InputError if a stage takes no
    part in the run or is not installed, or a parameter is unknown or does not fit.
    """
    taking_part = tuple(stages)
    if absent := sorted(set(parameters) - set(taking_part)):
        raise InputError(f"no stage of this run: {not_among(absent, taking_part)}")
    factories = {}
    for stage in taking_part:
        read = ParameterOverrides(stage, parameters.get(stage, {}))
        factories[stage] = stage_reader(stage, ego)(read)
        read.check()
    return factories
