"""Criteria: limits on measures of a run, and on those of all runs of a campaign; what is not measured fails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import fsum, inf
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator

from litsim_eval.analysis.measure import COUNT, SHARE, MetricField
from litsim_eval.analysis.metrics import find_field, leaves
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.scenario import packaged

PACKAGE, DEFAULT, SAFETY = "litsim_eval", "default", "safety"
"""Names of the packaged sets of criteria: all that a drive should be, and safety alone."""

_KINDS = {bool: "true or false", int: "a number", float: "a number", str: "a text"}
Value = bool | int | float | str
Limit = Annotated[float, Field(allow_inf_nan=False)]
PASSED_SHARE = "passed_share"
COUNTS = ("runs", "passed", "failed", "errors", "unfinished", PASSED_SHARE)
"""Counts of a campaign: its cases, those with each verdict, those not run; and the share of all cases that passed."""

Aggregate = Literal["mean", "median", "min", "max", "sum"]
_AGGREGATES: dict[Aggregate, Callable[[list[float]], float]] = {
    "mean": fmean,
    "median": median,
    "min": min,
    "max": max,
    "sum": fsum,
}


class Verdict(StrEnum):
    """Verdict of a campaign on a run."""

    PASSED = "passed"
    FAILED = "failed"  # a criterion is not met
    ERROR = "error"  # it could not be judged: no measures, or not those of a valid run


class Limits(BaseModel):
    """Limits on a value: bounds, or allowed values.

    Attributes:
        name: name in tables; default: the field and its limit.
        field: field that is judged.
        min, max: bounds, inclusive.
        equals: the only allowed value.
        one_of: the allowed values.
        when_missing: whether a missing value passes, as for a measure of something that never happened.
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
        limits = [name for name in ("min", "max", "equals", "one_of") if getattr(self, name) is not None]
        if not limits:
            raise ValueError(f"criterion on {self.field}: no limit, expected min, max, equals or one_of")
        if len(limits) > 1 and limits != ["min", "max"]:
            raise ValueError(f"criterion on {self.field}: {' and '.join(limits)}, expected one of them, or min and max")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"criterion on {self.field}: min is {self.min:g}, expected at most max, {self.max:g}")
        return self

    @property
    def limit(self) -> str:
        """The limits as text, such as ``at least 1``."""
        bounds = [
            f"{wording} {bound:g}"
            for wording, bound in (("at least", self.min), ("at most", self.max))
            if bound is not None
        ]
        return " and ".join(bounds) or (
            _as_text(self.equals) if self.one_of is None else f"one of {', '.join(map(_as_text, self.one_of))}"
        )

    @property
    def measure(self) -> str:
        """The judged field or aggregate, as text."""
        return self.field

    @property
    def title(self) -> str:
        """The name, or the field and its limit without one."""
        return self.name or f"{self.measure} {self.limit}"

    def judge(self, value: Value | None) -> CriterionResult:
        """Checks `value` against the limits; None stands for a missing measure."""
        if value is None:
            passed = self.when_missing == "pass"
            fault = "is missing"
        else:
            passed = self._keeps(value)
            fault = f"is {_as_text(value)}, expected {self.limit}"
        reason = "" if passed else f"{self.measure} {fault}"
        return CriterionResult(self.title, self.measure, value, self.limit, passed, reason)

    def _keeps(self, value: Value) -> bool:
        if self.min is not None or self.max is not None:
            if isinstance(value, str | bool):
                return False
            return (self.min is None or value >= self.min) and (self.max is None or value <= self.max)
        allowed = [
            limit for limit in (self.one_of or (self.equals,)) if isinstance(limit, bool) == isinstance(value, bool)
        ]
        return value in allowed


def _check_kinds(criterion: Limits, field: MetricField) -> None:
    """Checks that the limits are of the type of the field; raises ValueError if one is not."""
    for name in ("min", "max"):
        if getattr(criterion, name) is not None and not field.counts:
            raise ValueError(f"field {criterion.field}: {name} of what is no number, expected equals or one_of")
    values = criterion.one_of or ([] if criterion.equals is None else [criterion.equals])
    _check_between(criterion, field, values)
    kinds = field.kinds | ({int, float} if field.counts else set())
    for value in values:
        if type(value) not in kinds:
            wanted = " or ".join(sorted({_KINDS[kind] for kind in kinds if kind in _KINDS}))
            raise ValueError(f"field {criterion.field} never is {_as_text(value)}, expected {wanted}")


def _check_between(criterion: Limits, field: MetricField, values: Sequence[Value]) -> None:
    """Checks that the limits are within the range of the field: others would be met never, or always.

    Raises:
        ValueError: one is not.
    """
    if (between := field.between) is None:
        return
    limits: list[tuple[str, Value | None]] = [("min", criterion.min), ("max", criterion.max)]
    limits += [("equals" if criterion.one_of is None else "one_of", value) for value in values]
    for name, value in limits:
        if isinstance(value, int | float) and not between.low <= value <= between.high:
            share = between == SHARE
            expected = "a share from 0 to 1" if share else f"{between.low:g} or more"
            raise ValueError(f"field {criterion.measure}: {name} is {_as_text(value)}, expected {expected}")


class Criterion(Limits):
    """A limit on a field of `metrics.json`, given by its dotted path; a list counts by its length."""

    @model_validator(mode="after")
    def _check_field(self) -> Criterion:
        _check_kinds(self, find_field(self.field))
        return self

    def of_run(self, metrics: Mapping[str, Any]) -> CriterionResult:
        """Judges one run by its measures."""
        return self.judge(counted(leaves(metrics).get(self.field)))


class SuiteCriterion(Limits):
    """A limit on all runs together: on one of :data:`COUNTS`, or on an aggregate of a field of `metrics.json`.

    Attributes:
        aggregate: aggregate of the values of the runs; the mean of booleans is the share of true. It is missing if a
            run lacks the field; if `when_missing` is pass, such runs are left out.
    """

    aggregate: Aggregate | None = None

    @model_validator(mode="after")
    def _check_field(self) -> SuiteCriterion:
        if self.aggregate is None:
            if self.field not in COUNTS:
                counts = ", ".join(COUNTS)
                raise ValueError(f"field {self.field} without aggregate, expected one, or a field among {counts}")
            share = self.field == PASSED_SHARE
            _check_kinds(self, MetricField(self.field, frozenset({float if share else int}), SHARE if share else COUNT))
            return self
        field = find_field(self.field)
        if not field.counts and bool not in field.kinds:
            raise ValueError(f"field {self.field}: aggregate of what is no number")
        between = SHARE if bool in field.kinds else field.between
        if self.aggregate == "sum" and between is not None:  # so far all begin at 0
            between = COUNT
        _check_kinds(self, MetricField(self.field, frozenset({float}), between))
        return self

    @property
    def measure(self) -> str:
        """The judged field or aggregate, as text."""
        return f"{self.aggregate} of {self.field}" if self.aggregate else self.field

    @property
    def least(self) -> float:
        """The smallest number within the limits."""
        values = self.one_of or ([] if self.equals is None else [self.equals])
        return min((float(value) for value in values), default=-inf if self.min is None else self.min)

    def of_runs(self, outcomes: Sequence[CaseOutcome]) -> CriterionResult:
        """Judges all runs of a campaign."""
        if self.aggregate is None:
            return self.judge(_counts(outcomes)[self.field])
        values = [counted(leaves(outcome.metrics or {}).get(self.field)) for outcome in outcomes]
        numbers = [float(value) for value in values if value is not None and not isinstance(value, str)]
        if len(numbers) < len(values) and self.when_missing == "fail":
            reason = f"{self.field} is missing in {len(values) - len(numbers)} of {len(values)} runs"
            return CriterionResult(self.title, self.measure, None, self.limit, passed=False, reason=reason)
        return self.judge(_AGGREGATES[self.aggregate](numbers) if numbers else None)


class CaseOutcome(NamedTuple):
    """Outcome of one case for the criteria of the suite; the verdict is None if it has not been run."""

    verdict: Verdict | None
    metrics: Mapping[str, Any] | None


ALL_PASS = SuiteCriterion(name="all runs pass", field=PASSED_SHARE, min=1.0)
NO_ERRORS = SuiteCriterion(name="no errors", field="errors", max=0.0)
NO_GAPS = SuiteCriterion(name="all runs are done", field="unfinished", max=0.0)


class Criteria(BaseModel):
    """The criteria of a campaign.

    Attributes:
        runs: limits on every run.
        suite: limits on all runs together, by which the campaign passes or fails.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    runs: Annotated[list[Criterion], Field(min_length=1)]
    suite: Annotated[list[SuiteCriterion], Field(min_length=1)] = [ALL_PASS]

    def of_runs(self, outcomes: Sequence[CaseOutcome]) -> tuple[CriterionResult, ...]:
        """Judges all cases of a campaign, whether they were run or not.

        Runs that are errors fail it, unless :attr:`suite` limits the number of passes or errors; so do cases that have
        not been run, unless it limits their number.
        """
        limited = {criterion.field for criterion in self.suite}
        more = [] if limited & {"passed", PASSED_SHARE, "errors"} else [NO_ERRORS]
        more += [] if "unfinished" in limited else [NO_GAPS]
        return tuple(criterion.of_runs(outcomes) for criterion in (*self.suite, *more))

    def check_counts(self, runs: int) -> None:
        """Refuses limits on :data:`COUNTS` that a campaign of `runs` runs can never meet.

        Raises:
            ValueError: there is one; the message begins with its place among these fields.
        """
        for number, criterion in enumerate(self.suite):
            if criterion.aggregate is None and criterion.field != PASSED_SHARE and criterion.least > runs:
                fault = f"{criterion.field} is at most {runs}, the number of runs, expected {criterion.limit}"
                raise ValueError(f"suite.{number}: {fault}")

    @model_validator(mode="after")
    def _check_names(self) -> Criteria:
        for part in ("runs", "suite"):
            names = [criterion.title for criterion in getattr(self, part)]
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"{part}: {', '.join(twice)} more than once, expected different names")
        return self

    @classmethod
    def load(cls, name_or_path: str = DEFAULT, folder: Path | None = None) -> Criteria:
        """Reads a packaged set, :data:`DEFAULT` or :data:`SAFETY`, or a file, relative to `folder`.

        Raises:
            InputError: the file cannot be read, or a field does not fit.
        """
        path = (
            packaged(f"criteria/{name_or_path}.yaml", PACKAGE)
            if name_or_path in (DEFAULT, SAFETY)
            else (folder or Path()) / name_or_path
        )
        return read_yaml(path, cls)


@dataclass(frozen=True)
class CriterionResult:
    """Result of one criterion for a value.

    Attributes:
        name: name of the criterion.
        field: field or aggregate that is judged.
        value: its value; None if missing.
        limit: its limits as text.
        passed: whether they are met.
        reason: why not, in one line; empty if they are.
    """

    name: str
    field: str
    value: Value | None
    limit: str
    passed: bool
    reason: str


def counted(value: Any) -> Value | None:
    """Returns the value of a measure for criteria and tables: the length of a list; None for what is none."""
    return float(len(value)) if isinstance(value, list) else value if isinstance(value, Value) else None


def _as_text(value: Value | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float | int) else str(value)


def _counts(outcomes: Sequence[CaseOutcome]) -> dict[str, float | int | None]:
    verdicts = Counter(outcome.verdict for outcome in outcomes)
    passed, total = verdicts[Verdict.PASSED], len(outcomes)
    share = passed / total if total else None
    counts = (total, passed, verdicts[Verdict.FAILED], verdicts[Verdict.ERROR], verdicts[None], share)
    return dict(zip(COUNTS, counts, strict=True))
