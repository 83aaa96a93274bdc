"""Policy setups: named policies with the parameters of their stages."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from litsim_sim.core.quantities import OneOf
from litsim_sim.io.yaml_input import parse_yaml, read_text, validate_yaml
from litsim_sim.scenario.run_info import policy_names
from litsim_sim.scenario.scenario import packaged

PACKAGE, SETUPS = "litsim_eval", "setups"  # folder of the packaged ones
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


def _checked(values: dict[str, Any]) -> dict[str, Any]:
    return {stage_and_name(name): value for name, value in values.items()}


Parameters = Annotated[dict[str, Any], AfterValidator(_checked)]
"""Values of parameters by `stage.name`."""


class PolicySetup(BaseModel):
    """A policy with parameters and a name of its own: a variant of it that campaigns compare.

    Attributes:
        name: name in tables.
        kind: one of :func:`litsim_sim.scenario.run_info.policy_names`.
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


def packaged_setups() -> tuple[str, ...]:
    """Returns names of the packaged setups, sorted."""
    return tuple(sorted(path.stem for path in packaged(SETUPS, PACKAGE).glob("*.yaml")))


def setup_of(policy: str | PolicySetup) -> PolicySetup:
    """Returns the setup that an entry of a suite means: itself, a packaged one by its name, or a policy as it comes."""
    if isinstance(policy, PolicySetup):
        return policy
    return PolicySetup(name=policy, kind=policy) if policy in policy_names() else _packaged(policy)


@lru_cache
def _packaged(name: str) -> PolicySetup:
    path = packaged(f"{SETUPS}/{name}.yaml", PACKAGE)
    text = read_text(path)
    return validate_yaml(parse_yaml(text, str(path), PolicySetup), PolicySetup, str(path), text)
