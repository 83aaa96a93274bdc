"""What lies in the folder of a campaign: its cases, a result for each that is finished, and how it is gone on with."""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from litsim_sim.campaign.case import Case
from litsim_sim.campaign.criteria import Criteria, CriterionResult, Outcome, Verdict
from litsim_sim.campaign.suite import Suite
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing

FORMAT = 1
CAMPAIGN_FILE = "campaign.json"
RESULT_FILE = "result.json"
RESULTS_FILE = "results.json"
RUNS_FOLDER = "runs"
LOCK_FILE = ".lock"


@dataclass(frozen=True)
class RunResult:
    """One finished case.

    Attributes:
        case: that was run.
        verdict: on it.
        reason: why it has not passed, in one line; empty where it has.
        criteria: each that it was judged by; none where it could not be judged.
        metrics: the tree of `metrics.json`; None where it left none.
        recording, report, log: folder or files, relative to the run's folder; None where there is none.
        wall_s: that the run took [s].
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
        """The result of a run that was measured; `files` are further fields. One that is not valid is an error."""
        if not metrics["valid"]:
            return cls.error(case, f"the run is not valid: {metrics['why']}", metrics=metrics, **files)
        found = tuple(criterion.of_run(metrics) for criterion in criteria.runs)
        reason = "; ".join(f"{each.name}: {each.reason}" for each in found if not each.passed)
        verdict = Verdict.FAILED if reason else Verdict.PASSED
        return cls(case, verdict, reason, found, metrics, **({"finished_at": _now()} | files))

    @classmethod
    def error(cls, case: Case, reason: str, metrics: Mapping[str, Any] | None = None, **files: Any) -> RunResult:
        """The result of a run that could not be judged, and why; `files` are further fields."""
        said = " ".join(reason.split())
        return cls(case, Verdict.ERROR, said, (), metrics, **({"finished_at": _now()} | files))

    def judged_again(self, criteria: Criteria) -> RunResult:
        """The same run held against other criteria; what was an error stays one."""
        if self.verdict == Verdict.ERROR or self.metrics is None:
            return self
        files = {name: getattr(self, name) for name in ("recording", "report", "log", "wall_s", "finished_at")}
        return RunResult.judged(self.case, self.metrics, criteria, **files)

    def to_json(self) -> dict[str, Any]:
        """Plain values for JSON; :meth:`from_json` makes the same of them."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        own |= {"case": self.case.to_json(), "verdict": self.verdict.value}
        own |= {"criteria": [asdict(each) for each in self.criteria]}
        return {"format": FORMAT, **own}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> RunResult:
        """The result that :meth:`to_json` has written; KeyError, TypeError or ValueError where it has not."""
        own = {name: values[name] for name in cls.__dataclass_fields__}
        own |= {"case": Case.from_json(values["case"]), "verdict": Verdict(values["verdict"])}
        own |= {"criteria": tuple(CriterionResult(**each) for each in values["criteria"])}
        return cls(**own)


@dataclass(frozen=True)
class Campaign:
    """What a campaign's folder holds.

    Attributes:
        folder: where it lies.
        name: of the suite.
        criteria: by which the runs are judged.
        versions: of what the runs depend on.
        cases: that are to be run, in order.
        results: of those that are finished, in the same order.
        begun_at: date and time, ISO 8601, UTC.
    """

    folder: Path
    name: str
    criteria: Criteria
    versions: Mapping[str, str]
    cases: tuple[Case, ...]
    results: tuple[RunResult, ...]
    begun_at: str

    @property
    def judged(self) -> tuple[CriterionResult, ...]:
        """The campaign held against the criteria of its suite; it passes where all of them do."""
        by_id = {result.case.id: result for result in self.results}
        found = (by_id.get(case.id) for case in self.cases)
        return self.criteria.of_runs([Outcome(*((r.verdict, r.metrics) if r else (None, None))) for r in found])

    @property
    def missing(self) -> tuple[Case, ...]:
        """Cases without a result, in order."""
        done = {result.case.id for result in self.results}
        return tuple(case for case in self.cases if case.id not in done)


class CampaignFolder:
    """The folder of a campaign while it runs; every file in it is written whole or not at all.

    Attributes:
        path: of the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other programs on this machine from running a campaign in this folder; a killed one keeps nobody.

        Raises:
            InputError: one is running here, or the folder cannot be used.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            lock = (self.path / LOCK_FILE).open("w")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be used: {error.strerror or error}") from error
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise InputError(f"{self.path}: another campaign is running here") from error
            yield

    def begin(
        self, suite: Suite, cases: Sequence[Case], versions: Mapping[str, str], *, overwrite: bool = False
    ) -> dict[str, RunResult]:
        """Begin a campaign, or go on with the one that lies here.

        Folders of runs without a result, which a killed campaign leaves behind, are removed. Results that were judged
        by other criteria are judged again, from their measures.

        Args:
            suite: resolved.
            cases: of the suite; those of a campaign that lies here must all be among them.
            versions: of what the runs depend on.
            overwrite: whether a campaign that lies here is removed.

        Returns:
            Results of the cases that are finished already, by id of the case.

        Raises:
            InputError: another campaign lies here, or the folder cannot be used.
        """
        if overwrite and self._file.exists():
            self._remove()
        begun_at = _now()
        if self._file.exists():
            earlier = read_campaign(self.path)
            self._check_same(earlier, cases, versions)
            begun_at = earlier.begun_at
        self._remove_unfinished()
        described = suite.model_dump(mode="json")
        _write(
            self._file,
            {
                "format": FORMAT,
                "name": suite.name,
                "suite": described,
                "criteria": described["criteria"],
                "versions": dict(versions),
                "cases": [case.to_json() for case in cases],
                "begun_at": begun_at,
            },
        )
        done = {}
        for result in read_results(self.path, cases):
            again = result.judged_again(suite.criteria)
            done[result.case.id] = again
            if again.criteria != result.criteria:
                self.store(again)
        return done

    def finished(self, cases: Sequence[Case]) -> list[RunResult]:
        """Results of those of `cases` that lie here, as they were judged; for looking without touching anything.

        Raises:
            InputError: one cannot be read.
        """
        return read_results(self.path, cases)

    def run_folder(self, case: Case) -> Path:
        """Where the run of `case` leaves its files."""
        return self.path / RUNS_FOLDER / case.id

    def clear(self, case: Case) -> Path:
        """Make the folder of the run of `case` empty; returns it."""
        folder = self.run_folder(case)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def store(self, result: RunResult) -> None:
        """Write a result, whole: from then on its case is finished.

        Raises:
            Unwritable: it cannot be written.
        """
        _write(self.run_folder(result.case) / RESULT_FILE, result.to_json())

    def write_results(self, results: Iterable[RunResult], **more: Any) -> Path:
        """Write the file with all results, in their order; `more` are further fields of it. Returns its path.

        Raises:
            Unwritable: it cannot be written.
        """
        path = self.path / RESULTS_FILE
        _write(path, {"format": FORMAT, **more, "runs": [result.to_json() for result in results]})
        return path

    @property
    def _file(self) -> Path:
        return self.path / CAMPAIGN_FILE

    def _check_same(self, earlier: Campaign, cases: Sequence[Case], versions: Mapping[str, str]) -> None:
        """Check that all cases of the campaign that lies here are among `cases`.

        Raises:
            InputError: some are not.
        """
        ids = {case.id for case in cases}
        if not (other := [case for case in earlier.cases if case.id not in ids]):
            return
        changed = [
            f"{name} {earlier.versions.get(name)}, now {version}"
            for name, version in versions.items()
            if earlier.versions.get(name) != version
        ]
        why = f" ({'; '.join(changed)})" if changed else ""
        raise InputError(
            f"{self.path}: holds another campaign: {len(other)} of its {len(earlier.cases)} cases are not of this one, "
            f"such as {other[0].name}{why}; expected another --out, or --overwrite"
        )

    def _remove(self) -> None:
        shutil.rmtree(self.path / RUNS_FOLDER, ignore_errors=True)
        for name in (RESULTS_FILE, CAMPAIGN_FILE):
            (self.path / name).unlink(missing_ok=True)

    def _remove_unfinished(self) -> None:
        for folder in (self.path / RUNS_FOLDER).glob("*"):
            if not (folder / RESULT_FILE).is_file():
                shutil.rmtree(folder, ignore_errors=True)


def is_campaign(path: Path) -> bool:
    """Whether `path` is the folder of a campaign."""
    return (path / CAMPAIGN_FILE).is_file()


def read_campaign(path: Path) -> Campaign:
    """Read the campaign in the folder `path`, finished or not.

    Raises:
        InputError: there is none, or one of its files is damaged or of another format.
    """
    file = path / CAMPAIGN_FILE
    values = _read(file)
    try:
        cases = tuple(Case.from_json(each) for each in values["cases"])
        return Campaign(
            folder=path,
            name=values["name"],
            criteria=Criteria(**values["criteria"]),
            versions=values["versions"],
            cases=cases,
            results=tuple(read_results(path, cases)),
            begun_at=values["begun_at"],
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{file}: not a campaign: {type(error).__name__}: {error}") from error


def read_results(path: Path, cases: Iterable[Case]) -> list[RunResult]:
    """Results of those of `cases` that are finished, in their order, from the folder `path`.

    Name, tags and events are those of `cases`: a suite may have been told more since.

    Raises:
        InputError: one cannot be read.
    """
    found = []
    for case in cases:
        file = path / RUNS_FOLDER / case.id / RESULT_FILE
        if not file.is_file():
            continue
        values = _read(file)
        try:
            found.append(replace(RunResult.from_json(values), case=case))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{file}: not a result of a run: {type(error).__name__}: {error}") from error
    return found


def _read(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    found = values.get("format") if isinstance(values, dict) else None
    if found != FORMAT:
        raise InputError(f"{path}: format {found}, expected {FORMAT}")
    return dict(values)


def _write(path: Path, values: Mapping[str, Any]) -> None:
    text = json.dumps(values, indent=1, allow_nan=False) + "\n"
    with replacing(path) as new:
        new.write_text(text, encoding="utf-8")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
