"""The drivers of the ego by name."""

from __future__ import annotations

from typing import Any

from litsim_policy.ego.ego import Ego
from litsim_sim.core import plugins
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.stages import EGO
from litsim_sim.scenario.scenario import Scenario


def make_ego(name: str, scenario: Scenario, **parameters: Any) -> Ego:
    """The installed ego `name` for a run of `scenario`, with `parameters` of the ego's stage by name.

    Raises:
        InputError: the name or a parameter is unknown, or the ego cannot be made.
    """
    read = ParameterOverrides(EGO, parameters)
    ego: Ego = plugins.load(plugins.EGOS, name).read(read)(scenario)
    read.check()
    return ego
