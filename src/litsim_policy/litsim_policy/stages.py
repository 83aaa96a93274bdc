"""The cores of the stages with the parameters that each has: for their nodes, the in-process runner, and re-runs.

Each function reads its parameters and returns what builds the core once the run is known.
"""

from __future__ import annotations

from collections.abc import Callable

from litsim_policy.conflict import ConflictConfig
from litsim_policy.ego import Ego, make_ego
from litsim_policy.ego.bat import BatConfig
from litsim_policy.ego.idm import CAREFUL
from litsim_policy.ego.perturbed import PerturbedConfig
from litsim_policy.handback import HandbackConfig
from litsim_policy.policies import Policy, make_policy
from litsim_policy.policy_c import PolicyCConfig
from litsim_policy.takeover import TakeoverConfig, TakeoverManager
from litsim_policy.yield_policy import YieldConfig
from litsim_sim.parameters import Read
from litsim_sim.scenario import Scenario


def conflict_stage(read: Read) -> Callable[[Scenario], TakeoverManager]:
    """Who is off its log, and why."""
    conflict, takeover = read(ConflictConfig()), read(TakeoverConfig())
    return lambda scenario: TakeoverManager(scenario, conflict, takeover)


def policy_stage(read: Read) -> Callable[[str, Scenario], Policy]:
    """How those drive; the first argument is the name of the policy."""
    rules, handback, policy_c = read(YieldConfig()), read(HandbackConfig(), "handback."), read(PolicyCConfig())
    return lambda name, scenario: make_policy(name, scenario, rules, handback, policy_c)


def ego_stage(name: str, read: Read) -> Callable[[Scenario], Ego]:
    """The ego called `name`."""
    idm = read(CAREFUL) if name == "idm" else CAREFUL
    perturbed = read(PerturbedConfig()) if name == "perturbed" else None
    bat = read(BatConfig()) if name == "bat" else None
    return lambda scenario: make_ego(name, scenario, idm, perturbed, bat)
