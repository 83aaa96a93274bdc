"""What can move the background: installed policies, log replay, and setups, policies with parameters of their own."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import Parameters as StageParameters
from litsim_sim.core.parameters import by_place, not_among
from litsim_sim.core.quantities import OneOf
from litsim_sim.io.yaml_input import parse_yaml, read_text, validate_yaml
from litsim_sim.scenario.scenario import packaged

REPLAY = "replay"
"""The policy that is pure log replay, without stages of the policy."""
Name = Annotated[str, Field(min_length=1)]


def stage_and_name(name: str) -> str:
    """Checks that `name` has the form of a parameter, such as conflict.horizon, and returns it.

    Raises:
        ValueError: it is not.
    """
    stage, _, rest = name.partition(".")
    if not (stage and rest):
        raise ValueError(f"{name!r}, expected STAGE.NAME, such as conflict.horizon")
    return name


Parameters = Annotated[
    dict[str, Any], AfterValidator(lambda values: {stage_and_name(name): value for name, value in values.items()})
]
"""Values of parameters by `stage.name`."""


class PolicySetup(BaseModel):
    """A policy with parameters and a name of its own: a variant of it that campaigns compare.

    Attributes:
        name: name in tables.
        kind: one of :func:`litsim_sim.scenario.policies.policy_names`.
        description: purpose.
        parameters: values of its stages' parameters by `stage.name`, such as ``{conflict.horizon: 5.0}``.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    name: Name
    kind: Annotated[str, OneOf(policy_names)]
    description: str = ""
    parameters: Parameters = {}

    @property
    def label(self) -> str:
        """Label of its variants; empty for the policy as it comes."""
        return "" if self.name == self.kind else self.name

    def stage_parameters(self, given: StageParameters | None = None) -> StageParameters:
        """Returns its parameters by stage, with the `given` ones over them."""
        own, given = by_place(self.parameters.items()), given or {}
        return {stage: {**own.get(stage, {}), **given.get(stage, {})} for stage in (*own, *given)}


def policy_names() -> tuple[str, ...]:
    """Returns the names of what can move the background: the installed policies, and pure replay."""
    return (*plugins.names(plugins.POLICIES), REPLAY)


def installed_setups() -> tuple[str, ...]:
    """Returns names of the installed setups, sorted."""
    return plugins.names(plugins.SETUPS)


def policy_choices() -> tuple[str, ...]:
    """Returns what a user may name as a policy: :func:`.policy_names`, and the installed setups."""
    return (*policy_names(), *installed_setups())


def setup_of(policy: str | PolicySetup) -> PolicySetup:
    """Returns the setup that a name means, an installed one or a policy as it comes; a setup itself.

    Raises:
        InputError: there is none of that name, or its file cannot be used.
    """
    if isinstance(policy, PolicySetup):
        return policy
    if policy in policy_names():
        return PolicySetup(name=policy, kind=policy)
    if policy in installed_setups():
        return _installed(policy)
    raise InputError(f"policy {not_among([policy], policy_choices())}")


@lru_cache
def _installed(name: str) -> PolicySetup:
    path = packaged(f"{name}.yaml", plugins.load(plugins.SETUPS, name).__name__)
    text = read_text(path)
    return validate_yaml(parse_yaml(text, str(path), PolicySetup), PolicySetup, str(path), text)


def drives_by_region(policy: str | type[Any]) -> bool:
    """Returns whether the policy takes over, for good and without forecasts, every agent that comes near the ego."""
    return policy != REPLAY and bool(class_of_policy(policy).by_region)


def drives_walkers(policy: str | type[Any]) -> bool:
    """Returns whether the policy also drives walkers and cyclists whose way is blocked."""
    return policy != REPLAY and bool(class_of_policy(policy).drives_walkers)


def class_of_policy(policy: str | type[Any]) -> type[Any]:
    """Returns the class of the installed policy of that name; a class of policies itself.

    Raises:
        InputError: there is none of that name, or it cannot be imported.
    """
    return policy if isinstance(policy, type) else plugins.load(plugins.POLICIES, policy)
