"""The folder of a campaign while it runs: writing results, resuming, keeping earlier verdicts, refusing others."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from litsim_eval.campaign.case import ID_LENGTH, Case, what_differs
from litsim_eval.campaign.junit import JUNIT_FILE
from litsim_eval.campaign.results import (
    EXPERIMENT_REPORT_FILE,
    FORMAT,
    RESULT_FILE,
    RESULTS_FILE,
    RUNS_FOLDER,
    Campaign,
    RunResult,
    Shard,
    now,
    read_campaign,
    read_results,
)
from litsim_eval.campaign.results_table import TABLE_FILE, write_results_table
from litsim_eval.campaign.suite import CAMPAIGN_FILE, Suite
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import Unwritable, try_lock, write_json

LOCK_FILE = ".lock"
HISTORY_FOLDER = "history"
"""In the folder of a campaign: a folder 1, 2, ... for each time that something has changed, a campaign of its own."""
RUN_FOLDER = re.compile(f"[0-9a-f]{{{ID_LENGTH}}}")
"""Pattern of the names of folders of runs; other files beside them are not the campaign's, and stay."""


class CampaignFolder:
    """The folder of a campaign while it runs; every file in it is written whole or not at all.

    Attributes:
        path: the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Locks the folder against other campaigns on this machine; the lock ends with the process.

        Raises:
            InputError: one is running here, or the folder cannot be used.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            lock = (self.path / LOCK_FILE).open("w")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be used: {error.strerror or error}") from error
        with lock:
            if not try_lock(lock):
                raise InputError(f"{self.path}: another campaign is running here")
            yield

    def changes(self, cases: Sequence[Case], versions: Mapping[str, str], *, is_part: bool = False) -> Counter[str]:
        """Returns why cases of the campaign in this folder are not among `cases`, with the number of cases of each.

        Args:
            cases: to be run here.
            versions: versions of the dependencies of the runs.
            is_part: whether they are a part of a suite; then others of the campaign may not be missing.

        Raises:
            InputError: this folder holds another campaign, or more than the part, or cannot be used.
        """
        if not self._file.exists():
            return Counter()
        earlier = read_campaign(self.path)
        ids, named = {case.id for case in cases}, {case.name: case for case in cases}
        others = [case for case in earlier.cases if case.id not in ids]
        gone = [case for case in others if case.name not in named]
        if gone and (is_part or len(gone) == len(earlier.cases)):
            whole = "another campaign" if len(gone) == len(earlier.cases) else "more than this part of a suite"
            raise InputError(
                f"{self.path}: holds {whole}: {len(gone)} of its {len(earlier.cases)} cases are not of this one, "
                f"such as {gone[0].name}; expected another --out, or --overwrite"
            )
        return Counter(
            what_differs(case, named[case.name], earlier.versions, versions)
            if case.name in named
            else "not in the suite any more"
            for case in others
        )

    def begin(
        self,
        suite: Suite,
        cases: Sequence[Case],
        versions: Mapping[str, str],
        *,
        overwrite: bool = False,
        is_part: bool = False,
        shard: Shard | None = None,
    ) -> dict[str, RunResult]:
        """Begins a campaign, or resumes the one in this folder.

        Results of cases that have changed, or are not in the suite any more, are kept in :data:`HISTORY_FOLDER`.
        Folders of runs without a result, which a killed campaign leaves behind, are removed; foreign files in the
        folder stay. Results that were judged by other criteria are stored with their verdicts by those of `suite`.

        Args:
            suite: the resolved suite.
            cases: cases of the suite, or of a part of it.
            versions: versions of the dependencies of the runs.
            overwrite: whether a campaign in this folder is removed.
            is_part: see :meth:`changes`.
            shard: which part of a campaign `cases` are, if they are to be merged with the others.

        Returns:
            Results of the cases that are finished already, by id of the case.

        Raises:
            InputError: the folder holds another campaign, or cannot be used.
        """
        if overwrite and self._file.exists():
            self._remove()
        earlier = read_campaign(self.path) if self._file.exists() else None
        if earlier is not None and self.changes(cases, versions, is_part=is_part):
            self._set_aside(earlier, cases)
        self._remove_unfinished()
        described = suite.model_dump(mode="json")
        write_json(
            self._file,
            {
                "format": FORMAT,
                "name": suite.name,
                "suite": described,
                "criteria": described["criteria"],
                "versions": dict(versions),
                "cases": [case.to_json() for case in cases],
                "begun_at": now() if earlier is None else earlier.begun_at,
                "shard": None if shard is None else asdict(shard),
            },
        )
        done = {result.case.id: result for result in read_results(self.path, cases, suite.criteria)}
        if earlier is not None and earlier.criteria != suite.criteria:
            for result in done.values():
                if result.metrics is not None:
                    self.store(result)
        return done

    def run_folder(self, case: Case) -> Path:
        """Returns the folder of the files of the run of `case`."""
        return self.path / RUNS_FOLDER / case.id

    def clear(self, case: Case) -> Path:
        """Creates the folder of the run of `case`, or empties it; returns it.

        Raises:
            Unwritable: it cannot be made.
        """
        folder = self.run_folder(case)
        shutil.rmtree(folder, ignore_errors=True)
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise Unwritable(f"{folder}: cannot be made: {error.strerror or error}") from error
        return folder

    def store(self, result: RunResult) -> None:
        """Writes a result atomically: from then on its case is finished; raises Unwritable if it cannot be written."""
        write_json(self.run_folder(result.case) / RESULT_FILE, result.to_json())

    def write_results(self, results: Sequence[RunResult], **more: Any) -> Path:
        """Writes the file with all results, in order, and the further fields `more`, and the table; returns its path.

        Raises:
            Unwritable: it cannot be written.
        """
        path = self.path / RESULTS_FILE
        write_json(path, {"format": FORMAT, **more, "runs": [result.to_json() for result in results]})
        write_results_table(results, self.path / TABLE_FILE)
        return path

    @property
    def history(self) -> list[Path]:
        """The folders of what the campaign was before something changed, the newest last."""
        numbers = [int(path.name) for path in (self.path / HISTORY_FOLDER).glob("*") if path.name.isdecimal()]
        return [self.path / HISTORY_FOLDER / str(number) for number in sorted(numbers)]

    def _set_aside(self, earlier: Campaign, cases: Sequence[Case]) -> None:
        """Keeps all results of the campaign in this folder as they are, and removes those not of `cases` from it.

        Recordings of runs that will be run again are not kept; all else of them, as reports and logs, is.
        """
        number = 1 + max((int(path.name) for path in self.history), default=0)
        target = self.path / HISTORY_FOLDER / str(number)
        begun = target.with_name(f"{number}.new")  # there already if this was interrupted; then it is gone on with
        if not (earlier.results or begun.exists()):
            return
        (begun / RUNS_FOLDER).mkdir(parents=True, exist_ok=True)
        shutil.copy(self._file, begun)
        ids, names = {case.id for case in cases}, {case.name for case in cases}
        old = [result.case for result in earlier.results if result.case.id not in ids]
        for result in earlier.results:
            if result.case.id in ids:
                (begun / RUNS_FOLDER / result.case.id).mkdir(exist_ok=True)
                shutil.copy(self.run_folder(result.case) / RESULT_FILE, begun / RUNS_FOLDER / result.case.id)
        for case in old:
            shutil.move(self.run_folder(case), begun / RUNS_FOLDER / case.id)
            for record in (begun / RUNS_FOLDER / case.id).rglob("*.mcap") if case.name in names else ():
                record.unlink()
        begun.rename(target)

    @property
    def _file(self) -> Path:
        return self.path / CAMPAIGN_FILE

    def _remove(self) -> None:
        for folder in (*self._run_folders(), self.path / HISTORY_FOLDER):
            shutil.rmtree(folder, ignore_errors=True)
        for name in (RESULTS_FILE, TABLE_FILE, JUNIT_FILE, EXPERIMENT_REPORT_FILE, CAMPAIGN_FILE):
            (self.path / name).unlink(missing_ok=True)

    def _remove_unfinished(self) -> None:
        for folder in self._run_folders():
            if not (folder / RESULT_FILE).is_file():
                shutil.rmtree(folder, ignore_errors=True)

    def _run_folders(self) -> list[Path]:
        """Returns the folders of runs in this folder."""
        return [folder for folder in (self.path / RUNS_FOLDER).glob("*") if RUN_FOLDER.fullmatch(folder.name)]
