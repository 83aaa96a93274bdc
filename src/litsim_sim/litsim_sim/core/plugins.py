"""Plug-ins: what installed packages add to LitSim, by entry points of their distributions.

A package names a class or a function in an entry point of one of the groups below, and every program of LitSim knows it
by the name of the entry point. LitSim's own stages, policies, egos, predictors, metrics and formats are registered in
the same way. `docs/extending.md` has an example of each.

A stage is an entry point of ``litsim.stages``: a function that reads the stage's configurations with a
:class:`~litsim_sim.core.parameters.ParameterOverrides`, and returns a factory of the stage for a scenario. The ego's
stage is that of its driver, a plug-in of ``litsim.egos``. The launcher, which imports no package above its own, thus
checks parameters with the same functions as the nodes and runs in process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, distributions
from typing import Any, ClassVar

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides, Parameters, not_among
from litsim_sim.core.stages import EGO

STAGES = "litsim.stages"
"""Functions that read the parameters of a stage; see :func:`configured_stages`."""
POLICIES = "litsim.policies"
"""Policies of the background: classes as `litsim_policy.driving.policy.Policy`."""
SETUPS = "litsim.setups"
"""Policies with parameters of their own: packages that hold the YAML file of that name; see `scenario.policies`."""
EGOS = "litsim.egos"
"""Drivers of the ego: classes as `litsim_policy.ego.ego.Ego`."""
EGO_BATCHES = "litsim.ego_batches"
"""What plans for the drivers of the egos of several scenes at once: `litsim_policy.ego.batched.BatchedEgos`."""
ADAPTERS = "litsim.adapters"
"""Kinds of stacks that drive the ego: objects as `litsim_sim.launch.adapters.EgoAdapter`."""
PREDICTORS = "litsim.predictors"
"""Predictors: classes as `litsim_predictor.forecast.PredictorPlugin`."""
NETWORKS = "litsim.networks"
"""A function that runs files of weights that have neither kernels nor a graph, of their path."""
METRICS = "litsim.metrics"
"""Measures of a run: objects as `litsim_eval.analysis.measure.Measure`."""
MAPS = "litsim.maps"
"""Formats of maps: objects as `litsim_data.maps.map_format.MapFormat`."""
SOURCES = "litsim.sources"
"""Recordings as they are published, with map and signals or without: objects as `litsim_data.sources.source.Source`."""
EXPORTS = "litsim.exports"
"""Formats that runs, scenarios and nets are exported to: objects as `litsim_data.exports.export.Export`."""
RECORDED = "litsim.recorded"
"""What the launcher calls once a run is recorded, such as its analysis: classes, made of the launcher's criteria."""
LISTED = "litsim.listed"
"""What `data list` names beside scenarios and nets: functions that return descriptions by name."""
VERBS = "litsim.verbs"
"""Programs by their verbs, in an installation by pip; a workspace has a file for each."""

PREFIX = "litsim."


class Configured:
    """Base class of plug-ins that are made for a run, with parameters of the stage that they take part in.

    Attributes:
        defaults: the configuration (:func:`litsim_sim.core.quantities.configuration`) with its default values; None for
            a plug-in without parameters.
        prefix: beginning of the names of its parameters within the stage, such as ``mine.`` for ``policy.mine.gap``.
    """

    defaults: ClassVar[Any] = None
    prefix: ClassVar[str] = ""

    @classmethod
    def read(cls, read: ParameterOverrides) -> Callable[..., Any]:
        """Read the parameters; the result makes the plug-in from its base class's arguments and its configuration."""
        if cls.defaults is None:
            return cls
        config = read(cls.defaults, cls.prefix)
        make: Callable[..., Any] = cls
        return lambda *arguments: make(*arguments, config)


def installed(group: str) -> Mapping[str, EntryPoint]:
    """Returns the entry points of `group`, in alphabetical order; raises InputError if two have one name."""
    by_name: dict[str, EntryPoint] = {}
    for entry in _entry_points().get(group, ()):
        other = by_name.setdefault(entry.name, entry)
        if other.value != entry.value:  # the same one twice: of a workspace, and of a wheel beside it
            raise InputError(
                f"two plug-ins of {group} are called {entry.name}: {_described(other)} and {_described(entry)}; "
                "uninstall one of them"
            )
    return dict(sorted(by_name.items()))


def names(group: str) -> tuple[str, ...]:
    """Returns the names of the plug-ins of `group`, in alphabetical order."""
    return tuple(installed(group))


def load(group: str, name: str) -> Any:
    """Returns the object that the entry point `name` of `group` refers to.

    Raises:
        InputError: there is none of that name, or it cannot be imported.
    """
    entry = installed(group).get(name)
    if entry is None:
        kind = group.removeprefix(PREFIX)
        raise InputError(f"{kind}: no installed package has {not_among([name], installed(group))}")
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"{group}: {_described(entry)} cannot be imported: {error}") from error


def package_of(group: str, name: str) -> str:
    """Returns the package, as ROS knows it, of plug-in `name` of `group`; raises InputError if there is none."""
    entry = installed(group).get(name)
    if entry is None or entry.dist is None:
        raise InputError(f"no installed package has {group} {name}; build the workspace (make build)")
    return entry.dist.name.replace("-", "_")


@cache
def _entry_points() -> dict[str, list[EntryPoint]]:
    """Returns all entry points of LitSim's groups; cached, as it reads the metadata of all installed packages."""
    points: dict[str, list[EntryPoint]] = {}
    first_on_path = {distribution.name: distribution for distribution in reversed(tuple(distributions()))}
    for distribution in first_on_path.values():
        for entry in distribution.entry_points:
            if entry.group.startswith(PREFIX):
                points.setdefault(entry.group, []).append(entry)
    return points


def _described(entry: EntryPoint) -> str:
    return f"{entry.value} of {entry.dist.name if entry.dist else 'an unknown package'}"


def stage_reader(stage: str, ego: str = "") -> Callable[[ParameterOverrides], Any]:
    """Returns the registered function of `stage`; for the ego's stage, the function of the driver called `ego`.

    Raises:
        InputError: no installed package has it.
    """
    if stage == EGO:
        read: Callable[[ParameterOverrides], Any] = load(EGOS, ego).read
        return read
    if stage not in installed(STAGES):
        raise InputError(f"no installed package has a stage {stage}; build the workspace (make build)")
    registered: Callable[[ParameterOverrides], Any] = load(STAGES, stage)
    return registered


def configured_stages(stages: Iterable[str], parameters: Parameters, ego: str = "") -> dict[str, Any]:
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
