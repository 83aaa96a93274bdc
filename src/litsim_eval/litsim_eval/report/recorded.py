"""What `launch` does with a run once it is recorded: its measures, its report, a verdict, a table on the terminal."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

from litsim_eval.analysis.metrics import METRICS_FILE, compute_metrics, write_metrics
from litsim_eval.campaign.criteria import Criteria, Verdict
from litsim_eval.campaign.results import judge
from litsim_eval.report.analyze import measure
from litsim_eval.report.run_report import REPORT_FILE, render, write_report
from litsim_eval.report.terminal import print_metrics
from litsim_eval.report.thumbnails import write_thumbnail
from litsim_eval.report.verdict import verdict_text
from litsim_sim.cli.program import run_status
from litsim_sim.core.errors import EXIT_FAILED, InputError
from litsim_sim.io.files import write_text
from litsim_sim.record.run import read_run


class RecordedAnalysis:
    """Measures a recorded run, writes its report, and judges it where there are criteria."""

    def __init__(self, criteria: str | None) -> None:
        """Read the criteria: a file, or the name of the packaged ones; None for no verdict.

        Raises:
            InputError: they cannot be used.
        """
        self._criteria = None if criteria is None else Criteria.load(criteria)

    def __call__(self, out: Path, *, quiet: bool, failed: bool, case: Path | None = None) -> int:
        """Write measures and report of the recording in `out`; returns 1 if the run is not valid, or does not pass.

        Args:
            out: folder of the run.
            quiet: whether nothing is printed but the verdict.
            failed: whether the run has failed: then the partial recording gets a report, if it can be read.
            case: folder of the case in a campaign, which gets a picture for the campaign's page; `out` then gets
                measures and report alone, without tables and overview, for which nobody may ask. None for a run alone.
        """
        if failed:
            with suppress(InputError):
                write_report(out)
            return 0
        run = read_run(out)
        if case is None:
            metrics = measure(run, out)
        else:
            metrics = compute_metrics(run)
            write_metrics(metrics, out / METRICS_FILE)
            write_thumbnail(run, metrics, case)
        status, verdict = run_status(metrics, out), ""
        if self._criteria is not None and not status:
            criteria = judge(metrics, self._criteria)
            missed = [criterion.reason for criterion in criteria if not criterion.passed]
            status = EXIT_FAILED if missed else 0
            name = (Verdict.FAILED if missed else Verdict.PASSED).value
            verdict = verdict_text(name, "; ".join(missed), criteria)
            print("\n".join(f"{name}  {reason}" for reason in missed) or name, file=sys.stderr)
        write_text(out / REPORT_FILE, render(run, metrics, verdict))
        if not quiet:
            print_metrics(metrics)
        return status
