"""The runs of a campaign on this machine: so many at a time, each judged and stored as soon as it is over."""

from __future__ import annotations

import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field

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

        Whatever ends it early, such as Ctrl-C, ends the runs in progress first; nothing is stored of them.
        """
        with Workers() as workers, ThreadPoolExecutor(self.processes) as threads:
            pending = [threads.submit(self._run_one, case, workers) for case in cases]
            try:
                for future in as_completed(pending):
                    yield future.result()
            except BaseException:
                without_interrupts(lambda: self._stop(workers, threads))
                raise

    def _stop(self, workers: Workers, threads: ThreadPoolExecutor) -> None:
        self._stopped.set()
        threads.shutdown(wait=False, cancel_futures=True)  # what has not begun will not
        workers.close()
        threads.shutdown()

    def _run_one(self, case: Case, workers: Workers) -> RunResult:
        """The result of a case, stored.

        Raises:
            RunStopped: the campaign has ended meanwhile.
        """
        folder = self.folder.clear(case)
        try:
            outcome = self._over_graph(case) if case.shell == GRAPH else workers.run(case, folder)
        except RunStopped:
            raise
        except Exception as error:  # noqa: BLE001 - whatever it is, the others are to go on, and the table is to say it
            outcome = RunOutcome(None, reason(error))
        if self._stopped.is_set():  # its process was ended: that says nothing about the run
            raise RunStopped
        result = outcome.judged(case, self.criteria)
        self.folder.store(result)
        return result

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
