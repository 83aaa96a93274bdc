"""What `launch` does with a run once it is recorded: its measures, its report and a table on the terminal."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from litsim_eval.analysis.analyze import measure
from litsim_eval.report.run_report import REPORT_FILE, render, save, write_report
from litsim_eval.report.terminal import print_metrics
from litsim_sim.cli.program import run_status
from litsim_sim.core.errors import InputError
from litsim_sim.record.run import read_run


def analyze_recorded(out: Path, *, quiet: bool, failed: bool) -> int:
    """Writes measures and report of the recording in `out`; returns the exit status: 1 if the run is not valid.

    Args:
        out: folder of the run.
        quiet: whether nothing is printed.
        failed: whether the run has failed: then the partial recording gets a report, if it can be read.
    """
    if failed:
        with suppress(InputError):
            write_report(out)
        return 0
    run = read_run(out)
    metrics = measure(run, out)
    save(render(run, metrics), out / REPORT_FILE)
    if not quiet:
        print_metrics(metrics)
    return run_status(metrics, out)
