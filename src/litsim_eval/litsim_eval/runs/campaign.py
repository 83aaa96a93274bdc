"""The runs of a campaign on this machine, several at a time; each is judged and stored as soon as it ends."""

from __future__ import annotations

import sys
import threading
from collections import Counter
from collections.abc import Collection, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass, field

from tqdm import tqdm

from litsim_eval.campaign.case import GRAPH, Case, cases_of, code_versions
from litsim_eval.campaign.criteria import Criteria, Verdict
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.junit import JUNIT_FILE, write_junit
from litsim_eval.campaign.results import Campaign, RunResult, read_campaign
from litsim_eval.campaign.suite import Suite
from litsim_eval.campaign.variant_summary import drawn_cases, variant_summary
from litsim_eval.report.experiment import write_experiment_report
from litsim_eval.report.verdict import show_verdicts
from litsim_eval.runs.batched import batches
from litsim_eval.runs.case_run import (
    PRELOADED,
    TIME_LIMIT_S,
    RunOutcome,
    RunStopped,
    check_cases,
    is_elsewhere,
    run_over_graph,
)
from litsim_eval.runs.ray_runs import RayRuns
from litsim_eval.runs.warm_runs import WarmRuns
from litsim_eval.runs.workers import Workers
from litsim_sim.core.errors import reason
from litsim_sim.launch.forked import preload
from litsim_sim.launch.signals import without_interrupts

VERDICT_NAMES = {Verdict.PASSED: "passed", Verdict.FAILED: "failed", Verdict.ERROR: "errors"}
SMOOTHING = 0.02  # of tqdm's time left: low, since the durations of runs vary widely
SIGNAL_S = 0.3  # [s] until a run that has failed is an error: a signal to all processes may reach its own first


@dataclass
class LocalRuns:
    """Runs cases in processes of this machine, and over DDS in domains of their own.

    Attributes:
        folder: of the results.
        criteria: by which runs are judged.
        processes: number of runs at a time.
        time_limit_s: after which a run over DDS has failed [s].
        warm: in whose processes stacks stay up from run to run; None to start them for each.
    """

    folder: CampaignFolder
    criteria: Criteria
    processes: int
    time_limit_s: float = TIME_LIMIT_S
    warm: WarmRuns | None = None
    _stopped: threading.Event = field(default_factory=threading.Event)
    _meeting: threading.Lock = field(default_factory=threading.Lock)

    def run(self, cases: Sequence[Case]) -> Generator[RunResult, None, None]:
        """Runs `cases` and yields the result of each once it is stored.

        Runs in process are stepped together where possible, and then end together. An interruption, such as Ctrl-C,
        ends the runs in progress without storing them.
        """
        portions = batches(cases, self.processes)
        preload(PRELOADED if any(case.execution_mode == GRAPH for case in cases) else Workers.__module__)
        here = sum(portion[0].execution_mode != GRAPH for portion in portions)
        with Workers(min(here, self.processes)) as workers, ThreadPoolExecutor(self.processes) as threads:
            pending = [threads.submit(self._run, portion, workers) for portion in portions]
            try:
                for future in as_completed(pending):
                    yield from future.result()
            except BaseException:
                without_interrupts(lambda: self._stop(workers, threads))
                raise

    def _stop(self, workers: Workers, threads: ThreadPoolExecutor) -> None:
        self._stopped.set()
        threads.shutdown(wait=False, cancel_futures=True)  # pending runs never start
        workers.close()
        threads.shutdown()

    def _run(self, cases: Sequence[Case], workers: Workers) -> list[RunResult]:
        """Runs `cases`, one over DDS or several in process, and stores and returns their results.

        Raises:
            RunStopped: the campaign was interrupted.
        """
        folders = [self.folder.clear(case) for case in cases]
        try:
            over_graph = cases[0].execution_mode == GRAPH
            outcomes = [self._over_graph(cases[0])] if over_graph else workers.run_batch(cases, folders)
        except RunStopped:
            raise
        except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
            outcomes = [RunOutcome(None, reason(error))] * len(cases)
        failed = any(outcome.metrics is None for outcome in outcomes)
        if self._stopped.wait(SIGNAL_S if failed else 0.0):  # what has ended the campaign has ended the runs
            raise RunStopped
        results = [outcome.judged(case, self.criteria) for case, outcome in zip(cases, outcomes, strict=True)]
        for result in results:
            self.folder.store(result)
        return results

    def _over_graph(self, case: Case) -> RunOutcome:
        where = self.folder.run_folder(case)
        if self.warm is not None and not is_elsewhere(case) and not case.ego.adapter:
            return self.warm.run(case, where, self._stopped.is_set, self.time_limit_s)
        with self._meeting if is_elsewhere(case) else nullcontext():  # the stack's domain takes one run at a time
            return run_over_graph(case, where, self._stopped.is_set, self.time_limit_s)


def run_the_rest(runs: LocalRuns | RayRuns, cases: Sequence[Case], done: Mapping[str, RunResult]) -> None:
    """Runs those of `cases` that are not `done`, with a progress bar that counts the verdicts.

    If that is interrupted, the campaign is concluded with the runs that are finished.
    """
    results = list(done.values())
    try:
        with (
            tqdm(total=len(cases), initial=len(done), unit="run", dynamic_ncols=True, smoothing=SMOOTHING) as bar,
            closing(runs.run([case for case in cases if case.id not in done])) as running,
        ):
            bar.set_postfix(verdict_counts(results), refresh=False)
            for result in running:
                results.append(result)
                if result.verdict != Verdict.PASSED:
                    bar.write(verdict_line(result), file=sys.stderr)
                bar.set_postfix(verdict_counts(results), refresh=False)
                bar.update()
    except BaseException:
        without_interrupts(lambda: conclude(runs.folder))
        raise


def run_suite(suite: Suite, folder: CampaignFolder, processes: int) -> Campaign:
    """Runs the cases of `suite`, or the rest of them, `processes` at a time; returns the campaign of the folder.

    Raises:
        InputError: a case cannot be run, or the folder holds another campaign or cannot be used.
    """
    versions = code_versions()
    cases = cases_of(suite, with_versions=versions)
    check_cases(cases)
    with folder.alone():
        run_the_rest(LocalRuns(folder, suite.criteria, processes), cases, folder.begin(suite, cases, versions))
        return conclude(folder)


def verdict_counts(results: Collection[RunResult]) -> dict[str, int]:
    """Returns how many runs have passed, failed and were errors."""
    verdicts = Counter(result.verdict for result in results)
    return {name: verdicts[verdict] for verdict, name in VERDICT_NAMES.items()}


def verdict_line(result: RunResult) -> str:
    """Returns verdict, name and reason of a run."""
    return f"{result.verdict:8}{result.case.name}: {result.reason}"


def conclude(folder: CampaignFolder) -> Campaign:
    """Writes results, JUnit file and page of the campaign in `folder`, finished or not, and returns it.

    Raises:
        InputError: a file cannot be read or written.
    """
    campaign = read_campaign(folder.path)
    folder.write_results(
        campaign.results,
        name=campaign.name,
        verdict=str(Verdict.PASSED if campaign.passes else Verdict.FAILED),
        suite=[asdict(result) for result in campaign.judged],
        variants={variant: variant_summary(results) for variant, results in campaign.variants.items()},
        drawn=[asdict(case) for case in drawn_cases(campaign.results)],
    )
    write_junit(campaign, folder.path / JUNIT_FILE)
    show_verdicts(campaign)
    write_experiment_report(campaign, quiet=False)
    return campaign
