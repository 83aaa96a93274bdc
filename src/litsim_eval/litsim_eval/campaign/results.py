"""Results of a campaign: one for each finished case, read from its folder."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from litsim_eval.analysis.measure import Metrics, in_percent, percent
from litsim_eval.analysis.metrics import measures_by_field
from litsim_eval.analysis.summary import check_summable
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.criteria import CaseOutcome, Criteria, CriterionResult, Verdict
from litsim_eval.campaign.suite import CAMPAIGN_FILE
from litsim_sim.core.errors import InputError, shown
from litsim_sim.core.installation import command, has_ros
from litsim_sim.io.yaml_input import validate_yaml

FORMAT = 2
READABLE = (1, FORMAT)  # in format 1, `variant` is called `row`, and `execution_mode` is `shell`
RESULT_FILE = "result.json"
RESULTS_FILE = "results.json"
RUNS_FOLDER = "runs"
EXPERIMENT_REPORT_FILE = "experiment.html"


@dataclass(frozen=True)
class RunResult:
    """One finished case.

    Attributes:
        case: the case.
        verdict: verdict on it, always computed from the measures.
        reason: why it has not passed, in one line; empty if it has.
        criteria: results of all criteria; empty if it could not be judged.
        metrics: the tree of `metrics.json`; None without measures.
        recording, report, log: folder or files, relative to the run's folder; None if missing.
        wall_s: wall time of the run [s].
        finished_at: date and time, ISO 8601, UTC.
    """

    case: Case
    verdict: Verdict
    reason: str
    criteria: tuple[CriterionResult, ...]
    metrics: Mapping[str, Any] | None
    recording: str | None = None
    report: str | None = None
    log: str | None = None
    wall_s: float | None = None
    finished_at: str = ""

    @classmethod
    def judged(cls, case: Case, metrics: Mapping[str, Any], criteria: Criteria, **files: Any) -> RunResult:
        """Returns the result of a run that was measured, an error if it is not valid; `files` are further fields."""
        if metrics["valid"] is not True:
            return cls.error(case, f"the run is not valid: {metrics['why']}", metrics=metrics, **files)
        judged = judge(metrics, criteria)
        reason = "; ".join(result.reason for result in judged if not result.passed)
        verdict = Verdict.FAILED if reason else Verdict.PASSED
        return cls(case, verdict, reason, judged, metrics, **({"finished_at": now()} | files))

    @classmethod
    def error(cls, case: Case, reason: str, metrics: Mapping[str, Any] | None = None, **files: Any) -> RunResult:
        """Returns the result of a run that could not be judged, and why; `files` are further fields."""
        one_line = " ".join(reason.split())
        return cls(case, Verdict.ERROR, one_line, (), metrics, **({"finished_at": now()} | files))

    def to_json(self) -> dict[str, Any]:
        """Returns the result as values for JSON; the inverse of :meth:`from_json`, by the same criteria."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        own |= {"case": self.case.to_json(), "verdict": self.verdict.value}
        own |= {"criteria": [asdict(criterion) for criterion in self.criteria]}
        return {"format": FORMAT, **own}

    @classmethod
    def from_json(cls, values: Mapping[str, Any], criteria: Criteria) -> RunResult:
        """Returns what :meth:`to_json` was made of, judged by `criteria`: the verdict in `values` is not believed.

        Raises:
            KeyError, TypeError, ValueError, AttributeError: `values` are others.
        """
        case, metrics = Case.from_json(values["case"]), values["metrics"]
        files = {name: values[name] for name in ("recording", "report", "log", "wall_s", "finished_at")}
        if metrics is None:
            return cls.error(case, values["reason"] or "the run has left no measures", **files)
        check_summable(metrics)
        return cls.judged(case, metrics, criteria, **files)


def judge(metrics: Mapping[str, Any], criteria: Criteria) -> tuple[CriterionResult, ...]:
    """Returns the results of all criteria of a run for its measures."""
    return tuple(_told(criterion.of_run(metrics), metrics) for criterion in criteria.runs)


def _told(criterion: CriterionResult, metrics: Mapping[str, Any]) -> CriterionResult:
    """Returns the result of a criterion with what happened as its reason, where it is not met."""
    if criterion.passed:
        return criterion
    sentence = what_happened(criterion.field, criterion.value, criterion.limit, metrics)
    return replace(criterion, reason=sentence or f"{criterion.name}: {criterion.reason}")


def rerun_command(campaign: Path, case: Case) -> str:
    """Returns the command that runs one case of the `campaign` in this folder again, with a report.

    It runs over DDS, which also records the run; where there is no ROS, in process.
    """
    out = ["--out", str(campaign / "reruns" / case.id)]
    if has_ros():
        of_suite = ["evaluate", "--suite", str(campaign), "--case", case.name, "--graph", "--overwrite"]
        return shlex.join([command(), *of_suite, *out])
    vehicle = ["run", "--scenario", case.scenario, "--ego-id", str(case.ego_id)]
    options = {"seed": case.seed, "draw": case.draw, "end-after-contact": case.end_after_contact_s}
    given = [f"--{name}={value}" for name, value in options.items() if value is not None]
    values = {**case.ego.parameters, **dict(case.parameters)}
    settings = ["--set", *(f"{name}={json.dumps(value)}" for name, value in values.items())] if values else []
    return shlex.join([command(), *vehicle, "--ego", case.ego.kind, "--policy", case.policy, *given, *settings, *out])


@dataclass(frozen=True, order=True)
class Shard:
    """A part of a campaign's cases, which runs in a folder of its own; see :mod:`litsim_eval.campaign.shards`.

    Attributes:
        whole: digest of all cases of the campaign.
        count: number of its shards.
        number: of this shard, from 1 on.
    """

    whole: str
    count: int
    number: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


@dataclass(frozen=True)
class Campaign:
    """The content of a campaign's folder.

    Attributes:
        folder: the folder.
        name: name of the suite.
        criteria: criteria by which the runs are judged.
        versions: versions of the dependencies of the runs.
        cases: cases to be run, in order.
        results: results of the finished cases, in the same order.
        begun_at: date and time, ISO 8601, UTC.
        shard: which shard of a larger campaign this is; None if it is none.
    """

    folder: Path
    name: str
    criteria: Criteria
    versions: Mapping[str, str]
    cases: tuple[Case, ...]
    results: tuple[RunResult, ...]
    begun_at: str
    shard: Shard | None = None

    @property
    def judged(self) -> tuple[CriterionResult, ...]:
        """Results of the criteria of the suite for the campaign."""
        by_id = {result.case.id: result for result in self.results}
        results = (by_id.get(case.id) for case in self.cases)
        return self.criteria.of_runs([CaseOutcome(*((r.verdict, r.metrics) if r else (None, None))) for r in results])

    @property
    def passes(self) -> bool:
        """Whether it meets every criterion of its suite."""
        return all(result.passed for result in self.judged)

    @property
    def variants(self) -> dict[str, list[RunResult]]:
        """The finished runs of each variant, in the order of the cases; a variant may have none yet."""
        variants: dict[str, list[RunResult]] = {case.variant: [] for case in self.cases}
        for result in self.results:
            variants[result.case.variant].append(result)
        return variants

    @property
    def missing(self) -> tuple[Case, ...]:
        """Cases without a result, in order."""
        done = {result.case.id for result in self.results}
        return tuple(case for case in self.cases if case.id not in done)


def is_campaign(path: Path) -> bool:
    """Returns whether `path` is the folder of a campaign."""
    return (path / CAMPAIGN_FILE).is_file()


def read_campaign(path: Path) -> Campaign:
    """Reads the campaign in the folder `path`, finished or not.

    Raises:
        InputError: there is none, or one of its files is damaged or of another format.
    """
    file = path / CAMPAIGN_FILE
    values = _read(file)
    try:
        cases = tuple(Case.from_json(case) for case in values["cases"])
        criteria = validate_yaml(values["criteria"], Criteria, f"{file}: criteria", "")
        return Campaign(
            folder=path,
            name=values["name"],
            criteria=criteria,
            versions=values["versions"],
            cases=cases,
            results=tuple(read_results(path, cases, criteria)),
            begun_at=values["begun_at"],
            shard=Shard(**values["shard"]) if values.get("shard") else None,
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{file}: not a campaign: {type(error).__name__}: {error}") from error


def read_results(path: Path, cases: Iterable[Case], criteria: Criteria) -> list[RunResult]:
    """Returns results of those of `cases` that are finished, in their order, from the folder `path`.

    Verdicts are computed from the measures, by `criteria`; a file that cannot be read makes its case an error. Name,
    tags and events are those of `cases`: they may have been added to the suite since.
    """
    files = ((case, path / RUNS_FOLDER / case.id / RESULT_FILE) for case in cases)
    return [_read_result(file, case, criteria) for case, file in files if file.is_file()]


def _read_result(file: Path, case: Case, criteria: Criteria) -> RunResult:
    """Returns the result of `case` in `file`; an error if it cannot be read."""
    try:
        values = _read(file)
        result = RunResult.from_json(values, criteria)
        fault = "" if result.case.id == case.id else f"{file}: is of case {result.case.id}, expected {case.id}"
    except InputError as error:
        fault = str(error)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        fault = f"{file}: not a result of a run: {type(error).__name__}: {shown(str(error))}"
    if not fault:
        return replace(result, case=case)
    return RunResult.error(case, f"{fault}; evaluate --retry-errors runs this case again", finished_at="")


def _read(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    written = values.get("format") if isinstance(values, dict) else None
    if written not in READABLE:
        raise InputError(f"{path}: format {written}, expected {FORMAT}")
    return dict(values)


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def now() -> str:
    """Returns date and time, ISO 8601, UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def what_happened(field: str, value: Any, limit: str, metrics: Metrics) -> str:
    """Returns a sentence on the criterion that a run misses; empty if there is none for its field.

    It is that of the measure, or of a title with a unit; of all else the criterion itself says enough.

    Args:
        field, value, limit: of the criterion, see :class:`litsim_eval.campaign.criteria.CriterionResult`.
        metrics: of the run.
    """
    measure = measures_by_field().get(field)
    if measure is None or value is None:
        return "" if measure is None else measure.missing
    with suppress(KeyError, TypeError, ValueError):  # of measures by an earlier version
        if measure.sentence is not None:
            return measure.sentence(value, limit, metrics)
        name = measure.title.format(field.rpartition(".")[2])
        if name and measure.share:
            return f"{name} {percent(value)}, expected {in_percent(limit)}"
        if name and measure.unit:
            return f"{name} {value:.2f} {measure.unit}, expected {limit} {measure.unit}"
    return ""
