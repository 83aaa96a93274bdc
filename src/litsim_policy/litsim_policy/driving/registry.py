"""The policy stage: policies by name."""

from __future__ import annotations

from collections.abc import Callable

from litsim_policy.driving.policy import Policy
from litsim_sim.core import plugins
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.scenario.policies import class_of_policy
from litsim_sim.scenario.setting import Setting


def policy_stage(read: ParameterOverrides) -> Callable[[str, Setting], Policy]:
    """Read the parameters of all installed policies; the result makes a policy from its name and a scenario."""
    factories = {name: class_of_policy(name).read(read) for name in plugins.names(plugins.POLICIES)}

    def build(name: str, scenario: Setting) -> Policy:
        class_of_policy(name)  # says which there are, if it is none of them
        policy: Policy = factories[name](scenario)
        return policy

    return build
