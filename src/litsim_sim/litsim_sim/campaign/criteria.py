"""Criteria: limits on measures of a run, and on those of all runs of a campaign; what is not measured fails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.scenario import packaged

DEFAULT = "default"
"""Name of the packaged set of criteria."""

Value = bool | int | float | str
Limit = Annotated[float, Field(allow_inf_nan=False)]
PASSED_SHARE = "passed_share"


class Limits(BaseModel):
    """What a value must keep: bounds, or one of some values.

    Attributes:
        name: in tables; the field and its limit where none is given.
        field: of what is judged.
        min, max: bounds that the value may reach.
        equals: the only value.
        one_of: the only values.
        when_missing: whether there being no value passes; for a measure that is missing where what it measures never
            happened.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    name: str = ""
    field: Annotated[str, Field(min_length=1)]
    min: Limit | None = None
    max: Limit | None = None
    equals: Value | None = None
    one_of: Annotated[list[Value], Field(min_length=1)] | None = None
    when_missing: Literal["fail", "pass"] = "fail"

    @model_validator(mode="after")
    def _check_limits(self) -> Limits:
        given = [name for name in ("min", "max", "equals", "one_of") if getattr(self, name) is not None]
        if not given:
            raise ValueError(f"criterion on {self.field}: no limit, expected min, max, equals or one_of")
        if len(given) > 1 and given != ["min", "max"]:
            raise ValueError(f"criterion on {self.field}: {' and '.join(given)}, expected one of them, or min and max")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"criterion on {self.field}: min is {self.min:g}, expected at most max, {self.max:g}")
        return self

    @property
    def limit(self) -> str:
        """What the value must keep, in words, such as ``at least 1``."""
        bounds = [
            f"{said} {bound:g}" for said, bound in (("at least", self.min), ("at most", self.max)) if bound is not None
        ]
        return " and ".join(bounds) or (
            _said(self.equals) if self.one_of is None else f"one of {', '.join(map(_said, self.one_of))}"
        )

    @property
    def title(self) -> str:
        """The name, or what is asked where it has none."""
        return self.name or f"{self.field} {self.limit}"

    def judge(self, value: Value | None) -> CriterionResult:
        """Hold `value` against the limits; None is a measure that is missing."""
        if value is None:
            passed = self.when_missing == "pass"
            return CriterionResult(
                self.title, self.field, None, self.limit, passed, "" if passed else f"{self.field} is missing"
            )
        passed = self._keeps(value)
        reason = "" if passed else f"{self.field} is {_said(value)}, expected {self.limit}"
        return CriterionResult(self.title, self.field, value, self.limit, passed, reason)

    def _keeps(self, value: Value) -> bool:
        if self.min is not None or self.max is not None:
            if isinstance(value, str | bool):
                return False
            return (self.min is None or value >= self.min) and (self.max is None or value <= self.max)
        return any(_equal(value, each) for each in (self.one_of or (self.equals,)))


class Criterion(Limits):
    """A limit on a field of `metrics.json`; a dotted path, of a list the number of its entries."""

    def of_run(self, metrics: Mapping[str, Any]) -> CriterionResult:
        """Judge one run by its measures."""
        return self.judge(value_at(metrics, self.field))


class Criteria(BaseModel):
    """By what a campaign is judged.

    Attributes:
        runs: limits that every run is to keep.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    runs: Annotated[list[Criterion], Field(min_length=1)]

    @model_validator(mode="after")
    def _check_names(self) -> Criteria:
        names = [each.title for each in self.runs]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"runs: {', '.join(twice)} more than once, expected different names")
        return self

    @classmethod
    def load(cls, name_or_path: str = DEFAULT, folder: Path | None = None) -> Criteria:
        """Read the packaged set :data:`DEFAULT`, or a file, relative to `folder`.

        Raises:
            InputError: the file cannot be read, or a field does not fit.
        """
        path = packaged(f"criteria/{DEFAULT}.yaml") if name_or_path == DEFAULT else (folder or Path()) / name_or_path
        return read_yaml(path, cls)


@dataclass(frozen=True)
class CriterionResult:
    """One criterion held against a value.

    Attributes:
        name: of the criterion.
        field: what is judged.
        value: that was found; None where it is missing.
        limit: that it was to keep, in words.
        passed: whether it does.
        reason: why not, in one line; empty where it does.
    """

    name: str
    field: str
    value: Value | None
    limit: str
    passed: bool
    reason: str


def value_at(metrics: Mapping[str, Any], field: str) -> Value | None:
    """The value at a dotted path; of a list the number of its entries; None where there is none.

    A key may itself hold dots, as the limits of `safety.ttc_below` do.
    """
    if field in metrics:
        found = metrics[field]
        return float(len(found)) if isinstance(found, list) else found if isinstance(found, Value) else None
    for key, inner in metrics.items():
        if isinstance(inner, Mapping) and field.startswith(f"{key}."):
            return value_at(inner, field.removeprefix(f"{key}."))
    return None


def _equal(a: Value, b: Value | None) -> bool:
    return a == b and isinstance(a, bool) == isinstance(b, bool)


def _said(value: Value | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float | int) else str(value)
