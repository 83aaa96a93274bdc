"""Policies by name, and the policy stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from litsim_policy.driving.policy import Policy, policy_class
from litsim_sim.core import plugins
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.stages import POLICY
from litsim_sim.scenario.setting import Setting


def make_policy(name: str, scenario: Setting, parameters: Mapping[str, Any] | None = None) -> Policy:
    """The installed policy `name` for a run of `scenario`, with `parameters` of the policy stage by name.

    Raises:
        InputError: the name or a parameter is unknown, or the policy cannot be made.
    """
    read = ParameterOverrides(POLICY, parameters or {})
    policy: Policy = policy_class(name).read(read)(scenario)
    read.check()
    return policy


def policy_stage(read: ParameterOverrides) -> Callable[[str, Setting], Policy]:
    """Read the parameters of all installed policies; the result makes a policy from its name and a scenario."""
    factories = {name: policy_class(name).read(read) for name in plugins.names(plugins.POLICIES)}

    def build(name: str, scenario: Setting) -> Policy:
        policy_class(name)  # says which there are, if it is none of them
        policy: Policy = factories[name](scenario)
        return policy

    return build
