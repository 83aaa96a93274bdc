"""A search: runs of changed scenarios as a campaign, and the margins that they give."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

from litsim_data.exports.openscenario import OpenScenario
from litsim_data.exports.reading import run_content
from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.part import write_suite
from litsim_eval.campaign.results import RunResult, read_results
from litsim_eval.campaign.suite import CaseEntry, EgoSetup, Suite
from litsim_eval.report.margins import write_margins_page
from litsim_eval.runs.campaign import LocalRuns, conclude
from litsim_eval.runs.case_run import RECORDING, plan_of
from litsim_eval.runs.in_process import record
from litsim_eval.runs.warm_runs import WarmRuns
from litsim_eval.search.case_search import CaseSearch
from litsim_eval.search.explore import Asked, Tried, explore, promising
from litsim_eval.search.margins import (
    FAILURES_FILE,
    PAGE_FILE,
    TABLE_FILE,
    Margins,
    write_tried,
)
from litsim_eval.search.people import People
from litsim_eval.search.space import DISTANCE_MAX, Proposal
from litsim_sim.core.errors import InputError
from litsim_sim.core.stages import POLICY_STAGES
from litsim_sim.io.files import make_folder, write_text
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.record.run import Run, read_run
from litsim_sim.scenario.run_info import EXTERNAL

SEARCH_FILE, SCENARIOS, RUNS, REPEATED = "search.json", "scenarios", "tried", "repeated"
SCREEN, STAND_IN, SCREEN_RUNS = "screen", "idm", 100  # folder, ego and most runs of a search before an external stack's
SCREENED = 0.25  # share of the budget for what that search found, and of the time for the search itself


@dataclass(frozen=True)
class Settings:
    """What a search does.

    Attributes:
        runs: budget of each scenario.
        sampler, seed: of the optimiser.
        only: kinds of change, or parameters, that may vary; none for all.
        minutes: time after which no further run begins; None for no limit.
        processes, time_limit_s: as in a campaign.
        graph: whether LitSim's own egos are run over DDS, too.
        warm: as in a campaign.
    """

    runs: int
    sampler: str
    seed: int
    only: tuple[str, ...]
    minutes: float | None
    processes: int
    time_limit_s: float
    graph: bool
    warm: WarmRuns | None = None


class Search:
    """A search in the scenarios of a suite with one ego and one policy.

    Attributes:
        all: the search in each case.
        screen: the search with a stand-in that is made before that of an external stack; None for LitSim's own egos.
    """

    def __init__(
        self,
        suite: Suite,
        cases: Sequence[Case],
        versions: Mapping[str, str],
        people: People,
        settings: Settings,
        out: Path,
    ) -> None:
        """Makes the space of every case; nothing is run or written yet.

        Raises:
            InputError: Optuna is not installed, a scenario cannot be used, or there are several variants.
        """
        if find_spec("optuna") is None:
            raise InputError(
                "Optuna is not installed: "
                ".venv/bin/pip install -r requirements/search.txt -c requirements/constraints.txt"
            )
        variants = list(dict.fromkeys(case.variant for case in cases))
        if len(variants) != 1:
            raise InputError(
                f"{len(variants)} variants: {'; '.join(variants)}; expected one: name it by --ego and --policy"
            )
        self._suite, self._versions, self._people, self._settings, self._out = suite, versions, people, settings, out
        self._folder = CampaignFolder(out / RUNS)
        self._begin = time.monotonic()
        self.all = [CaseSearch.of(case, people, settings.only) for case in cases]
        self.screen = self._stand_in() if cases[0].ego.kind == EXTERNAL else None

    @property
    def runs(self) -> int:
        """Budget of all scenarios together."""
        return self._settings.runs * len(self.all) + (0 if self.screen is None else self.screen.runs)

    def run(self, progress: Callable[[int], object] = lambda _: None) -> Margins:
        """Makes all runs, or those that are missing, writes everything, and returns the margins.

        Args:
            progress: told the number of runs that have ended.

        Raises:
            InputError: the folder holds another search, or cannot be used.
        """
        make_folder(self._out)
        with self._folder.alone():
            self._check_folder()
            if self.screen is not None:
                self.screen.run(progress)
            self._explore(progress)
            return self._conclude()

    def _stand_in(self) -> Search:
        """Returns a search in process, with an ego that costs little in place of the stack."""
        of_policy = {name: v for name, v in self._suite.parameters.items() if name.split(".")[0] in POLICY_STAGES}
        ego = EgoSetup(name=STAND_IN, kind=STAND_IN)
        suite = self._suite.model_copy(update={"egos": [ego], "parameters": of_policy})
        settings = replace(self._settings, runs=min(SCREEN_RUNS, self._settings.runs), graph=False)
        if settings.minutes is not None:
            settings = replace(settings, minutes=SCREENED * settings.minutes)
        cases = cases_of(suite, with_versions=self._versions)
        return Search(suite, cases, self._versions, self._people, settings, self._out / SCREEN)

    def _check_folder(self) -> None:
        """Notes in the folder what is searched; refuses that of another search."""
        path = self._out / SEARCH_FILE
        settings = {name: getattr(self._settings, name) for name in ("sampler", "seed")}
        settings["only"] = list(self._settings.only)
        note = {"cases": [search.case.key for search in self.all], "people": self._people.source} | settings
        if path.is_file() and json.loads(path.read_text(encoding="utf-8")) != note:
            raise InputError(f"{self._out}: holds another search; expected another --out, or --overwrite")
        write_text(path, json.dumps(note, indent=1) + "\n")

    def _explore(self, progress: Callable[[int], object]) -> None:
        settings = self._settings
        load_kernels()  # once, and not in the processes of each batch, which are forks of this one
        deadline = None if settings.minutes is None else self._begin + 60.0 * settings.minutes
        running = {
            k: explore(
                search.exploration,
                settings.runs,
                settings.sampler,
                settings.seed,
                [] if self.screen is None else self.screened(k),
                lambda: deadline is not None and time.monotonic() > deadline,
            )
            for k, search in enumerate(self.all)
        }
        asked = {k: next(exploring) for k, exploring in running.items()}
        while asked:
            outcomes = self._evaluate(asked, progress)
            asked = {}
            for k, tried in outcomes.items():
                try:
                    asked[k] = running[k].send(tried)
                except StopIteration:
                    del running[k]

    def screened(self, k: int) -> list[Proposal]:
        """Returns with what the stand-in failed, or nearly, in a case."""
        assert self.screen is not None
        return promising(self.screen.all[k].exploration, round(SCREENED * self._settings.runs))

    def _evaluate(self, asked: Mapping[int, Asked], progress: Callable[[int], object]) -> dict[int, list[Tried]]:
        """Returns what became of proposals, by number of the case; those that were run before are not run again."""
        batch = [
            (self.all[k], number, how, proposal)
            for k in asked
            for number, (how, proposal) in enumerate(asked[k], len(self.all[k].exploration.tried))
        ]
        for search, number, _, proposal in batch:
            self._make_case(search, number, proposal)
        cases = [search.cases[number] for search, number, *_ in batch if number in search.cases]
        done = {result.case.id: result for result in read_results(self._folder.path, cases, self._suite.criteria)}
        progress(len(batch) - len(cases) + len(done))
        with closing(self._runs(self._folder).run([case for case in cases if case.id not in done])) as running:
            for result in running:
                done[result.case.id] = result
                progress(1)
        for search, number, *_ in batch:
            if number in search.cases:
                search.results[number] = done[search.cases[number].id]
            if number == 0 and search.results[0].metrics is not None:
                search.place(self._run_of(search, 0), self._people, self._settings.only)
        tried = iter([search.tried(number, how, proposal) for search, number, how, proposal in batch])
        return {k: list(islice(tried, len(asked[k]))) for k in asked}

    def _suite_of(self, entries: Sequence[CaseEntry]) -> Suite:
        return self._suite.model_copy(update={"cases": list(entries), "seeds": []})

    def _runs(self, folder: CampaignFolder) -> LocalRuns:
        settings = self._settings
        return LocalRuns(folder, self._suite.criteria, settings.processes, settings.time_limit_s, settings.warm)

    def _make_case(self, search: CaseSearch, number: int, proposal: Proposal) -> None:
        """Writes the scenario of a proposal, and notes the case of its run, or why it cannot be run."""
        space, name = search.exploration.space, search.scenario_name(number)
        path = self._out / SCENARIOS / f"{name}.yaml"
        make_folder(path.parent)
        write_text(path, space.scenario_file(proposal, name))
        events = [change.model_dump(mode="json") for change in space.changes(proposal)]
        entry = search.entries[number] = CaseEntry(
            scenario=str(path.resolve()),
            ego_id=search.case.ego_id,
            seed=search.case.seed,
            tags=list(dict.fromkeys(event["kind"] for event in events)),
            events=events,
        )
        try:
            cases = cases_of(self._suite_of([entry]), graph=self._settings.graph, with_versions=self._versions)
        except InputError as error:
            search.results[number] = RunResult.error(search.case, str(error))
        else:
            search.cases[number] = next(case for case in cases if case.variant == search.case.variant)

    def _conclude(self) -> Margins:
        """Repeats the failures, and writes what the search leaves."""
        repeated = self._repeat()
        everything = [(search.entries[number], case) for search in self.all for number, case in search.cases.items()]
        suite = self._suite_of([entry for entry, _ in everything])
        self._folder.begin(suite, [case for _, case in everything], self._versions)
        conclude(self._folder)
        margins = Margins(
            ego=self.all[0].case.ego.name,
            policy=self.all[0].case.policy,
            bound=DISTANCE_MAX,
            people=self._people.source,
            settings=asdict(self._settings),
            versions=dict(self._versions),
            wall_s=round(time.monotonic() - self._begin, 1),
            scenarios=[search.margin(self._folder.path, repeated) for search in self.all],
        )
        rows = [[search.row(tried) for tried in search.exploration.tried] for search in self.all]
        write_tried([row for of_case in rows for row in of_case], self._out / TABLE_FILE)
        write_margins_page(margins.model_dump(), rows, self._out / PAGE_FILE)
        for search in self.all:
            if search.exploration.failures:
                self._export(search, search.exploration.failures[0])
        shown = [
            (search.entries[failure.number], failure.distance)
            for search in self.all
            for failure in search.exploration.failures
            if failure.number
        ]
        failed = [
            entry.model_copy(update={"events": [{"kind": "margin", "distance": distance}, *entry.events]})
            for entry, distance in shown
        ]
        (self._out / FAILURES_FILE).unlink(missing_ok=True)
        if failed:
            write_suite(self._suite_of(failed), self._out / FAILURES_FILE)
        margins.write(self._out)
        return margins

    def _export(self, search: CaseSearch, failure: Tried) -> None:
        """Writes what happens in a failure as OpenSCENARIO, beside its scenario."""
        run, name = self._run_of(search, failure.number), search.scenario_name(failure.number)
        with tempfile.TemporaryDirectory() as folder:
            OpenScenario().write(run_content(run, Path(folder)), self._out / SCENARIOS / f"{name}.xosc")

    def _run_of(self, search: CaseSearch, number: int) -> Run:
        """Returns a run: what was recorded of it, or the same once more."""
        case = search.cases[number]
        recording = self._folder.run_folder(case) / RECORDING
        return read_run(recording) if recording.is_dir() else record(plan_of(case))

    def _repeat(self) -> dict[str, RunResult]:
        """Runs the failures that are shown once more; returns the results by id of the case."""
        folder = CampaignFolder(self._out / REPEATED)
        cases = [case for search in self.all for case in search.failed_cases]
        with closing(self._runs(folder).run(cases)) as running:
            results = {result.case.id: result for result in running}
        shutil.rmtree(folder.path, ignore_errors=True)
        return results
