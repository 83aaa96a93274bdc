"""Policies by name."""

from __future__ import annotations

from typing import Protocol

from litsim_policy.handback import HandbackConfig
from litsim_policy.policy_c import PolicyC, PolicyNetwork, shipped_weights
from litsim_policy.safety import SafetyConfig
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
    safety: SafetyConfig | None = None,
) -> Policy:
    """The policy called `name`, for a run of `scenario`: `litsim` is policy C, `yield` the rules.

    Raises:
        InputError: there is none of that name.
    """
    if name not in ("litsim", "yield"):
        raise InputError(f"policy: {name!r} is unknown, expected litsim or yield")
    rules = YieldPolicy(scenario, config or YieldConfig(), handback or HandbackConfig())
    return rules if name == "yield" else PolicyC(scenario, PolicyNetwork.load(shipped_weights()), rules, safety)
