"""The runs of a campaign on this machine: several at a time, each judged and stored as soon as it is over."""

from __future__ import annotations

import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field

from litsim_policy.run.case_batch import batches
from litsim_policy.run.case_run import TIME_LIMIT_S, RunOutcome, RunStopped, is_elsewhere, run_over_graph
from litsim_policy.run.workers import Workers
from litsim_sim.campaign.case import GRAPH, Case
from litsim_sim.campaign.criteria import Criteria, Verdict
from litsim_sim.campaign.folder import CampaignFolder
from litsim_sim.campaign.junit import JUNIT_FILE, write_junit
from litsim_sim.campaign.results import Campaign, RunResult, read_campaign
from litsim_sim.campaign.row_summary import row_summary
from litsim_sim.core.errors import reason
from litsim_sim.launch.processes import without_interrupts
from litsim_sim.report.experiment import write_experiment_report


@dataclass
class LocalRuns:
    """Runs cases in processes of this machine, and over DDS in domains of their own.

    Attributes:
        folder: where results are stored.
        criteria: by which runs are judged.
        processes: runs at a time.
        time_limit_s: after which a run over DDS has failed [s].
    """

    folder: CampaignFolder
    criteria: Criteria
    processes: int
    time_limit_s: float = TIME_LIMIT_S
    _stopped: threading.Event = field(default_factory=threading.Event)
    _meeting: threading.Lock = field(default_factory=threading.Lock)

    def check(self, cases: Sequence[Case]) -> None:
        """Any cases can be run here."""

    def run(self, cases: Sequence[Case]) -> Generator[RunResult, None, None]:
        """Run `cases`; the result of each as it comes, stored by then.

        Runs in process are stepped together where they can be, and are over together. Whatever ends it early, such as
        Ctrl-C, ends the runs in progress first; nothing is stored of them.
        """
        with Workers() as workers, ThreadPoolExecutor(self.processes) as threads:
            pending = [threads.submit(self._run, some, workers) for some in batches(cases, self.processes)]
            try:
                for future in as_completed(pending):
                    yield from future.result()
            except BaseException:
                without_interrupts(lambda: self._stop(workers, threads))
                raise

    def _stop(self, workers: Workers, threads: ThreadPoolExecutor) -> None:
        self._stopped.set()
        threads.shutdown(wait=False, cancel_futures=True)  # what has not begun will not
        workers.close()
        threads.shutdown()

    def _run(self, cases: Sequence[Case], workers: Workers) -> list[RunResult]:
        """The results of `cases`, stored: one over DDS, or some in process.

        Raises:
            RunStopped: the campaign has ended meanwhile.
        """
        folders = [self.folder.clear(case) for case in cases]
        try:
            over_graph = cases[0].shell == GRAPH
            outcomes = [self._over_graph(cases[0])] if over_graph else workers.run_batch(cases, folders)
        except RunStopped:
            raise
        except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
            outcomes = [RunOutcome(None, reason(error))] * len(cases)
        if self._stopped.is_set():  # its process was ended: that says nothing about the runs
            raise RunStopped
        results = [outcome.judged(case, self.criteria) for case, outcome in zip(cases, outcomes, strict=True)]
        for result in results:
            self.folder.store(result)
        return results

    def _over_graph(self, case: Case) -> RunOutcome:
        where = self.folder.run_folder(case)
        if not is_elsewhere(case):
            return run_over_graph(case, where, self._stopped.is_set, self.time_limit_s)
        with self._meeting:  # there is one stack, in one domain
            return run_over_graph(case, where, self._stopped.is_set, self.time_limit_s)


def conclude(folder: CampaignFolder) -> Campaign:
    """Write what the campaign in `folder` comes to, as far as it has come: results, JUnit and page. Returns it.

    Raises:
        InputError: a file cannot be read or written.
    """
    campaign = read_campaign(folder.path)
    folder.write_results(
        campaign.results,
        name=campaign.name,
        verdict=str(Verdict.PASSED if campaign.passes else Verdict.FAILED),
        suite=[asdict(each) for each in campaign.judged],
        rows={row: row_summary(results) for row, results in campaign.rows.items()},
    )
    write_junit(campaign, folder.path / JUNIT_FILE)
    write_experiment_report(campaign, quiet=False)
    return campaign
