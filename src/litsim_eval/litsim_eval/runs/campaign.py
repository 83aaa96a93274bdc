"""The runs of a campaign on this machine, several at a time; each is judged and stored as soon as it ends."""

from __future__ import annotations

import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field

from litsim_eval.campaign.case import GRAPH, Case
from litsim_eval.campaign.criteria import Criteria, Verdict
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.junit import JUNIT_FILE, write_junit
from litsim_eval.campaign.results import Campaign, RunResult, read_campaign
from litsim_eval.campaign.variant_summary import variant_summary
from litsim_eval.report.experiment import write_experiment_report
from litsim_eval.report.verdict import show_verdicts
from litsim_eval.runs.batched import batches
from litsim_eval.runs.case_run import PRELOADED, TIME_LIMIT_S, RunOutcome, RunStopped, is_elsewhere, run_over_graph
from litsim_eval.runs.workers import Workers
from litsim_sim.core.errors import reason
from litsim_sim.launch.forked import preload
from litsim_sim.launch.signals import without_interrupts

SIGNAL_S = 0.3  # [s] until a run that has failed is an error: a signal to all processes may reach its own first


@dataclass
class LocalRuns:
    """Runs cases in processes of this machine, and over DDS in domains of their own.

    Attributes:
        folder: of the results.
        criteria: by which runs are judged.
        processes: number of runs at a time.
        time_limit_s: after which a run over DDS has failed [s].
    """

    folder: CampaignFolder
    criteria: Criteria
    processes: int
    time_limit_s: float = TIME_LIMIT_S
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
        if not is_elsewhere(case):
            return run_over_graph(case, where, self._stopped.is_set, self.time_limit_s)
        with self._meeting:  # the stack is in one domain, which takes one run at a time
            return run_over_graph(case, where, self._stopped.is_set, self.time_limit_s)


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
        suite=[asdict(each) for each in campaign.judged],
        variants={variant: variant_summary(results) for variant, results in campaign.variants.items()},
    )
    write_junit(campaign, folder.path / JUNIT_FILE)
    show_verdicts(campaign)
    write_experiment_report(campaign, quiet=False)
    return campaign
