"""`evaluate`: run a campaign: run and judge every case of a suite, with a table and a verdict on every run."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Self

from rich.console import Console
from tqdm import tqdm

from litsim_eval.campaign.case import Case, cases_of, code_versions
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import EXPERIMENT_REPORT_FILE, RESULTS_FILE, Campaign, RunResult
from litsim_eval.campaign.row_bounds import row_bounds
from litsim_eval.campaign.row_summary import row_summary
from litsim_eval.campaign.suite import place_of
from litsim_eval.cli.suite_arguments import add_suite_arguments, suite_of
from litsim_eval.runs.campaign import LocalRuns, conclude
from litsim_eval.runs.case_run import TIME_LIMIT_S, CaseRefused, check_cases
from litsim_eval.runs.ray_runs import LOCAL, RayRuns
from litsim_eval.runs.summary_table import print_summary
from litsim_sim.cli.arguments import DefaultsFormatter, Parser, positive
from litsim_sim.cli.program import at_least_one, interrupt_on_signals, program
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.launch.signals import without_interrupts
from litsim_sim.scenario.run_info import REPLAY

STATUS_HELP = (
    "Exit status: 0, the campaign passes by the criteria of its suite (by default: every run passes); 1, it does not, "
    "and stderr says why; 2, bad input; 130, interrupted; the same command resumes it."
)
DEFAULT_OUT = "bags/evaluation"
TOLD_AS = {Verdict.PASSED: "passed", Verdict.FAILED: "failed", Verdict.ERROR: "errors"}
SMOOTHING = 0.02  # of tqdm's time left: low, since the durations of runs vary widely
TOLD_MAX = 20  # most runs that have not passed and are printed with their reasons


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_eval evaluate``."""
    p = Parser(prog="evaluate", description=__doc__, epilog=STATUS_HELP, formatter_class=DefaultsFormatter)
    add_suite_arguments(p)
    p.add_argument("--graph", action="store_true", help="run LitSim's own egos over DDS, too, and record them")
    p.add_argument("--out", default=DEFAULT_OUT, help="folder of the campaign; an existing one is resumed")
    p.add_argument("--processes", type=at_least_one, default=2, help="number of runs at a time")
    p.add_argument(
        "--time-limit", type=positive, default=TIME_LIMIT_S, metavar="S", help="time limit of a run over DDS [s]"
    )
    p.add_argument(
        "--ray", metavar="ADDRESS", help=f"run on a Ray cluster: auto, HOST:PORT, or {LOCAL} for one of this machine"
    )
    p.add_argument("--dry-run", action="store_true", help="only list the runs to do and the runs done")
    p.add_argument("--retry-errors", action="store_true", help="repeat runs that could not be judged")
    p.add_argument("--overwrite", action="store_true", help="replace the campaign in the folder")
    p.add_argument(
        "--intervals",
        action="store_true",
        help="print 95 %% intervals behind the figures, by the bootstrap over the vehicles that are the ego",
    )
    return p


def evaluate(arguments: argparse.Namespace) -> int:
    """Run the campaign that the arguments describe, or the rest of it, and return the exit status.

    Raises:
        InputError: an argument or a file cannot be used; raised before the first run.
    """
    suite = suite_of(arguments)
    versions = code_versions()
    cases = cases_of(suite, graph=arguments.graph, with_versions=versions)
    try:
        check_cases(cases)
    except CaseRefused as error:  # for a parameter that only its stage can check
        where = f"{place_of(arguments.suite, error.setting)}: " if arguments.suite else ""
        raise InputError(f"{where}{error}") from error
    try:
        suite.criteria.check_counts(len(cases))
    except ValueError as error:
        within = "" if arguments.criteria else "criteria."
        raise InputError(f"{arguments.criteria or arguments.suite}: field {within}{error}") from error
    folder = CampaignFolder(Path(arguments.out))
    runs: LocalRuns | RayRuns = LocalRuns(folder, suite.criteria, arguments.processes, arguments.time_limit)
    if arguments.ray is not None:
        runs = RayRuns(folder, suite.criteria, arguments.ray, arguments.processes, arguments.time_limit)
    runs.check(cases)
    if arguments.dry_run:
        return _tell(cases, folder, arguments)
    with folder.alone():
        done = folder.begin(suite, cases, versions, overwrite=arguments.overwrite)
        if arguments.retry_errors:
            done = _judged(done)
        to_run = [case for case in cases if case.id not in done]
        try:
            with Progress(len(cases), done.values()) as progress, closing(runs.run(to_run)) as results:
                for result in results:
                    progress.add(result)
        except BaseException:  # finished runs are kept
            without_interrupts(lambda: conclude(folder))
            print_error("the campaign ended before all runs were done; the same command resumes it")
            raise
        campaign = conclude(folder)
    _print(campaign, intervals=arguments.intervals)
    print(f"report: {campaign.folder / EXPERIMENT_REPORT_FILE}")
    return 0 if campaign.passes else EXIT_FAILED


class Progress:
    """A progress bar with the numbers of runs that have passed, failed and were errors."""

    def __init__(self, total: int, done: Collection[RunResult]) -> None:
        self._counts = Counter(result.verdict for result in done)
        self._bar = tqdm(total=total, initial=len(done), unit="run", dynamic_ncols=True, smoothing=SMOOTHING)
        self._show()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def add(self, result: RunResult) -> None:
        """Count a finished run."""
        self._counts[result.verdict] += 1
        self._bar.update()
        self._show()

    def _show(self) -> None:
        told = {name: self._counts[verdict] for verdict, name in TOLD_AS.items()}
        self._bar.set_postfix(told, refresh=False)


def _tell(cases: Sequence[Case], folder: CampaignFolder, arguments: argparse.Namespace) -> int:
    """Print for every case its verdict, or that it is to be run; return the exit status."""
    done = {result.case.id: result for result in folder.finished(cases)}
    if arguments.retry_errors:
        done = _judged(done)
    for case in cases:
        print(f"{done[case.id].verdict if case.id in done else 'to run':8}{case.name}")
    print(f"{_counted(done.values())}; {len(cases) - len(done)} of {len(cases)} to be run")
    return 0


def _judged(results: Mapping[str, RunResult]) -> dict[str, RunResult]:
    """The `results` without those that are errors."""
    return {each: result for each, result in results.items() if result.verdict != Verdict.ERROR}


def _counted(results: Collection[RunResult]) -> str:
    counts = Counter(result.verdict for result in results)
    return ", ".join(f"{counts[verdict]} {name}" for verdict, name in TOLD_AS.items())


def _print(campaign: Campaign, *, intervals: bool) -> None:
    """Print the table, the criteria that the campaign fails, and the runs that have not passed, with reasons."""
    summary = {row: row_summary(results) for row, results in campaign.rows.items()}
    replayed = all(case.policy == REPLAY for case in campaign.cases)
    bounds = {row: row_bounds(results) for row, results in campaign.rows.items()} if intervals else None
    print_summary(campaign.name, summary, Console(), replayed=replayed, bounds=bounds)
    print(f"{_counted(campaign.results)}; every run: {campaign.folder / RESULTS_FILE}")
    for criterion in campaign.judged:
        if not criterion.passed:
            print_error(f"{criterion.name}: {criterion.reason}")
    bad = [result for result in campaign.results if result.verdict != Verdict.PASSED]
    for result in bad[:TOLD_MAX]:
        print_error(f"{result.case.name}: {result.verdict}: {result.reason}")
    if len(bad) > TOLD_MAX:
        print_error(f"and {len(bad) - TOLD_MAX} more, in {campaign.folder / RESULTS_FILE}")


@program
def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run litsim_eval evaluate``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    return evaluate(arguments)


if __name__ == "__main__":
    main()
