"""Policies by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from litsim_policy.driving.handback import HandbackConfig
from litsim_policy.driving.policy_c import PolicyC, PolicyCConfig
from litsim_policy.driving.yield_policy import YieldConfig, YieldPolicy
from litsim_research.baselines.idm_policy import IdmPolicy, IdmPolicyConfig
from litsim_research.baselines.imitation_policy import IMITATIONS, ImitationConfig, ImitationPolicy
from litsim_research.baselines.simnet.config import SimnetConfig
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.run_info import POLICIES, REPLAY
from litsim_sim.scenario.setting import Setting

DRIVING = tuple(name for name in POLICIES if name != REPLAY)


class Policy(Protocol):
    """Drives the agents off their logs."""

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Controls of the agents off their logs; called once per step, in order."""


def make_policy(
    name: str,
    scenario: Setting,
    config: YieldConfig | None = None,
    handback: HandbackConfig | None = None,
    policy_c: PolicyCConfig | None = None,
    idm: IdmPolicyConfig | None = None,
    simnet: SimnetConfig | None = None,
    *,
    imitation: ImitationConfig | None = None,
) -> Policy:
    """The policy called `name`, for a run of `scenario`: `litsim` is policy C, `yield` the rules, others are baselines.

    Raises:
        InputError: the name is unknown, or the weights cannot be used.
    """
    if name not in DRIVING:
        raise InputError(f"policy: {name!r} is unknown, expected one of {', '.join(DRIVING)}")
    if name == "idm":
        return IdmPolicy(scenario, idm or IdmPolicyConfig())
    if name == "simnet":
        from litsim_research.baselines.simnet.network import load_network
        from litsim_research.baselines.simnet.policy import SimnetPolicy

        return SimnetPolicy(scenario, load_network((simnet or SimnetConfig()).file()))
    if name in IMITATIONS:
        imitation = imitation or ImitationConfig()
        return ImitationPolicy(scenario, imitation.network(name), imitation)
    rules = YieldPolicy(scenario, config or YieldConfig(), handback or HandbackConfig())
    policy_c = policy_c or PolicyCConfig()
    return rules if name == "yield" else PolicyC(scenario, policy_c.network(), rules, policy_c.safety)


def policy_stage(read: ParameterReader) -> Callable[[str, Setting], Policy]:
    """Read the parameters of the policy stage; the result makes a policy from its name and a scenario."""
    rules, handback, policy_c = read(YieldConfig()), read(HandbackConfig(), "handback."), read(PolicyCConfig())
    idm, simnet = read(IdmPolicyConfig(), "baseline."), read(SimnetConfig(), "simnet.")
    imitation = read(ImitationConfig(), "imitation.")
    return lambda name, scenario: make_policy(
        name, scenario, rules, handback, policy_c, idm, simnet, imitation=imitation
    )
