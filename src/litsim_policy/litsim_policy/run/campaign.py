"""The runs of a campaign on this machine: so many at a time, each judged and stored as soon as it is over."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from typing import Any

from litsim_policy.run.case_run import TIME_LIMIT_S, RunOutcome, RunStopped, is_elsewhere, run_over_graph
from litsim_policy.run.workers import Workers
from litsim_sim.analysis.summary import summarise
from litsim_sim.campaign.case import GRAPH, Case
from litsim_sim.campaign.criteria import Criteria, CriterionResult, Verdict
from litsim_sim.campaign.folder import CampaignFolder
from litsim_sim.campaign.junit import JUNIT_FILE, write_junit
from litsim_sim.campaign.results import Campaign, RunResult, read_campaign
from litsim_sim.core.errors import reason
from litsim_sim.launch.processes import without_interrupts


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


def row_summaries(results: Iterable[RunResult]) -> dict[str, dict[str, Any]]:
    """What the runs of each row come to together: see :func:`litsim_sim.analysis.summary.summarise`, and verdicts.

    Verdicts are counted as `passed`, `not_passed` (by a criterion) and `errors`.
    """
    by_row: dict[str, list[RunResult]] = {}
    for result in results:
        by_row.setdefault(result.case.row, []).append(result)
    summaries = {}
    for row, mine in by_row.items():
        measured = [dict(result.metrics) for result in mine if result.metrics is not None]
        counts = Counter(result.verdict for result in mine)
        summaries[row] = summarise(measured, len(mine) - len(measured)) | {
            "passed": counts[Verdict.PASSED],
            "not_passed": counts[Verdict.FAILED],
            "errors": counts[Verdict.ERROR],
        }
    return summaries


def conclude(folder: CampaignFolder) -> Campaign:
    """Write what the campaign in `folder` comes to, as far as it has come, and return it.

    Raises:
        InputError: a file cannot be read or written.
    """
    campaign = read_campaign(folder.path)
    judged = campaign.judged
    folder.write_results(
        campaign.results,
        name=campaign.name,
        verdict=str(Verdict.PASSED if passes(judged) else Verdict.FAILED),
        suite=[asdict(each) for each in judged],
        rows=row_summaries(campaign.results),
    )
    write_junit(campaign, folder.path / JUNIT_FILE)
    return campaign


def passes(judged: Iterable[CriterionResult]) -> bool:
    """Whether a campaign passes, by what its criteria say of it as a whole."""
    return all(each.passed for each in judged)
