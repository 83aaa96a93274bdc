"""Policies by name."""

from __future__ import annotations

from typing import Protocol

from litsim_policy.handback import HandbackConfig
from litsim_policy.policy_c import PolicyC, PolicyCConfig
from litsim_policy.takeover import TakeoverTable
from litsim_policy.yield_policy import YieldConfig, YieldPolicy
from litsim_sim.errors import InputError
from litsim_sim.scenario import Scenario
from litsim_sim.scene import AgentTable, ControlTable


class Policy(Protocol):
    """Called once a step, in order."""

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Controls of the agents that are off their log."""


def make_policy(
    name: str,
    scenario: Scenario,
    config: YieldConfig | None = None,
    handback: HandbackConfig | None = None,
    policy_c: PolicyCConfig | None = None,
) -> Policy:
    """The policy called `name`, for a run of `scenario`: `litsim` is policy C, `yield` the rules.

    Raises:
        InputError: there is none of that name, or its weights cannot be used.
    """
    if name not in ("litsim", "yield"):
        raise InputError(f"policy: {name!r} is unknown, expected litsim or yield")
    rules = YieldPolicy(scenario, config or YieldConfig(), handback or HandbackConfig())
    if name == "yield":
        return rules
    policy_c = policy_c or PolicyCConfig()
    return PolicyC(scenario, policy_c.network(), rules, policy_c.safety)
