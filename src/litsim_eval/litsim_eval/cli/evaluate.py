"""`evaluate`: run a campaign: run and judge every case of a suite, with a table and a verdict on every run."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

from rich.console import Console

from litsim_eval.campaign.background import background_sentences
from litsim_eval.campaign.case import code_versions
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.part import write_suite
from litsim_eval.campaign.results import (
    EXPERIMENT_REPORT_FILE,
    RESULTS_FILE,
    Campaign,
    RunResult,
    read_results,
    rerun_command,
)
from litsim_eval.campaign.shards import merge, shard_of
from litsim_eval.campaign.variant_summary import drawn_cases, variant_bounds, variant_summary
from litsim_eval.cli.suite_arguments import add_suite_arguments, cases_to_run, refuse_unusable, suite_of
from litsim_eval.runs.campaign import LocalRuns, conclude, run_the_rest, verdict_counts, verdict_line
from litsim_eval.runs.case_run import TIME_LIMIT_S
from litsim_eval.runs.ray_runs import LOCAL, RayRuns
from litsim_eval.runs.summary_table import print_drawn, print_summary
from litsim_eval.runs.warm_runs import WarmRuns
from litsim_sim.cli.arguments import DefaultsFormatter, Parser, positive
from litsim_sim.cli.program import at_least_one, interrupt_on_signals, program
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.scenario.policies import REPLAY

STATUS_HELP = (
    "Exit status: 0, the campaign passes by the criteria of its suite (by default: every run passes); 1, it does not, "
    "and stderr says why; 2, bad input; 130, interrupted; the same command resumes it."
)
EXAMPLES = """examples:
  evaluate --suite small --ego external --out bags/mine -- python3 my_stack.py
      every case of a packaged suite, with a stack of yours as the ego
  evaluate --suite small --failed-in bags/mine --save-suite failed.yaml
      a suite of the cases that it has failed
  evaluate --scenario demo --ego idm perturbed --policy replay litsim --out bags/variants
      variants side by side: each ego with each policy

"""
DEFAULT_OUT = "bags/evaluation"
REASONS_MAX = 20  # most runs that have not passed and are printed with their reasons at the end


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval evaluate``."""
    p = Parser(prog="evaluate", description=__doc__, epilog=EXAMPLES + STATUS_HELP, formatter_class=ExamplesFormatter)
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
    some = p.add_mutually_exclusive_group()
    some.add_argument("--save-suite", type=Path, metavar="FILE", help="only write the chosen cases as a suite")
    some.add_argument(
        "--part", type=_part, metavar="I/N", help="run every N-th case from the I-th on, in a folder for --merge"
    )
    some.add_argument(
        "--merge", type=Path, nargs="+", metavar="FOLDER", help="only make one campaign of the folders of its N parts"
    )
    p.add_argument("--retry-errors", action="store_true", help="repeat runs that could not be judged")
    p.add_argument("--overwrite", action="store_true", help="replace the campaign in the folder")
    p.add_argument("--all", action="store_true", help="print the measures of the simulation, too")
    p.add_argument(
        "--intervals",
        action="store_true",
        help="print 95 %% intervals behind the figures, by the bootstrap over the vehicles that are the ego",
    )
    return p


def evaluate(arguments: argparse.Namespace) -> int:
    """Runs the campaign that the arguments describe, or the rest of it, and returns the exit status.

    Raises:
        InputError: an argument or a file cannot be used; raised before the first run.
    """
    folder = CampaignFolder(Path(arguments.out))
    if arguments.merge is not None:
        with folder.alone():
            merge(arguments.merge, folder)
            return _concluded(folder, arguments)
    suite = suite_of(arguments)
    versions = code_versions()
    whole, (suite, cases) = suite, cases_to_run(arguments, suite, versions)
    if arguments.save_suite is not None:
        write_suite(suite, arguments.save_suite)
        print(f"{arguments.save_suite}: {len(suite.cases)} cases")
        return 0
    try:
        suite.criteria.check_counts(len(cases))
    except ValueError as error:
        within = "" if arguments.criteria else "criteria."
        raise InputError(f"{arguments.criteria or arguments.suite}: field {within}{error}") from error
    shard, cases = (None, cases) if arguments.part is None else shard_of(cases, *arguments.part)
    is_part = suite is not whole or shard is not None
    refuse_unusable(arguments, cases)
    runs: LocalRuns | RayRuns
    runs = local = LocalRuns(folder, suite.criteria, arguments.processes, arguments.time_limit)
    if arguments.ray is not None:
        runs = RayRuns(folder, suite.criteria, arguments.ray, arguments.processes, arguments.time_limit)
        runs.check(cases)
    changes = Counter[str]() if arguments.overwrite else folder.changes(cases, versions, is_part=is_part)
    for why, count in changes.items():
        print(f"{count} cases of before: {why}")
    if arguments.dry_run:
        done = {result.case.id: result for result in read_results(folder.path, cases, suite.criteria)}
        done = _judged(done) if arguments.retry_errors else done
        for case in cases:
            print(f"{done[case.id].verdict if case.id in done else 'to run':8}{case.name}")
        print(f"{_counted(done.values())}; {len(cases) - len(done)} of {len(cases)} to be run")
        return 0
    with folder.alone():
        done = folder.begin(suite, cases, versions, overwrite=arguments.overwrite, is_part=is_part, shard=shard)
        if changes and folder.history:
            print(f"their verdicts are kept in {folder.history[-1]}; see the difference: compare {folder.path}")
        if arguments.retry_errors:
            done = _judged(done)
        try:
            with WarmRuns() if arguments.warm else nullcontext() as local.warm:
                run_the_rest(runs, cases, done)
        except BaseException:
            print_error("the campaign ended before all runs were done; the same command resumes it")
            raise
        return _concluded(folder, arguments)


def _part(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r}, expected I/N, such as 1/4, with I from 1 to N")
    return int(number), int(count)


def _concluded(folder: CampaignFolder, arguments: argparse.Namespace) -> int:
    """Writes and prints the campaign in `folder`; returns the exit status."""
    campaign = conclude(folder)
    _print(campaign, everything=arguments.all, intervals=arguments.intervals)
    print(f"report: {campaign.folder / EXPERIMENT_REPORT_FILE}")
    return 0 if campaign.passes else EXIT_FAILED


def _judged(results: Mapping[str, RunResult]) -> dict[str, RunResult]:
    """Returns the `results` without those that are errors."""
    return {variant: result for variant, result in results.items() if result.verdict != Verdict.ERROR}


def _counted(results: Collection[RunResult]) -> str:
    return ", ".join(f"{count} {name}" for name, count in verdict_counts(results).items())


def _print(campaign: Campaign, *, everything: bool, intervals: bool) -> None:
    """Prints the table, the criteria that the campaign fails, and runs that have not passed, with their reruns."""
    summary = {variant: variant_summary(results) for variant, results in campaign.variants.items()}
    replayed = all(case.policy == REPLAY for case in campaign.cases)
    bounds = {variant: variant_bounds(results) for variant, results in campaign.variants.items()} if intervals else None
    print_summary(campaign.name, summary, Console(), replayed=replayed, everything=everything, bounds=bounds)
    for sentence in background_sentences(campaign.cases):
        print(sentence)
    if drawn := drawn_cases(campaign.results):
        print_drawn(drawn, REASONS_MAX, Console())
    print(f"{_counted(campaign.results)}; every run: {campaign.folder / RESULTS_FILE}")
    for variant, results in campaign.variants.items():
        if sentence := contacts_of_passed(variant, results):
            print(sentence)
    for criterion in campaign.judged:
        if not criterion.passed:
            print(f"failed  {criterion.name}: {criterion.reason}", file=sys.stderr)
    bad = {variant: _worst_first(results) for variant, results in campaign.variants.items()}
    most = max(1, REASONS_MAX // max(1, sum(bool(results) for results in bad.values())))
    for variant, results in bad.items():
        for result in results[:most]:
            print(f"{verdict_line(result)}\n        {rerun_command(campaign.folder, result.case)}", file=sys.stderr)
        if len(results) > most:
            more = f"and {len(results) - most} more of {variant}: {campaign.folder / RESULTS_FILE}"
            print(f"        {more}", file=sys.stderr)


def contacts_of_passed(variant: str, results: Sequence[RunResult]) -> str:
    """Returns a sentence on those `results` of a variant that passed with contacts that the log has not, if any.

    Criteria may judge the ego alone, so that contacts at the background's fault fail no run.
    """
    passed = [result.metrics for result in results if result.verdict == Verdict.PASSED and result.metrics is not None]
    touching = [metrics for metrics in passed if not metrics["reactive"]]
    if not touching:
        return ""
    faults = Counter[str]()
    for metrics in touching:
        faults.update(metrics["collision"]["by_fault"])
    ego = faults.total() - faults["background"]
    return (
        f"{variant}: {len(touching)} of {len(passed)} runs that passed have contacts that the log has not, "
        f"{faults['background']} at the background's fault and {ego} at the ego's"
    )


def _worst_first(results: Sequence[RunResult]) -> list[RunResult]:
    """Returns the runs that have not passed: errors, then by the first criterion that they miss, as contacts."""
    bad = [result for result in results if result.verdict != Verdict.PASSED]
    return sorted(
        bad, key=lambda result: next((n for n, criterion in enumerate(result.criteria) if not criterion.passed), -1)
    )


class ExamplesFormatter(DefaultsFormatter):
    """Keeps the lines of the examples below the options as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        examples, blank, rest = text.rpartition("\n\n")
        return examples + blank + super()._fill_text(rest, width, indent)


@program
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval evaluate``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    return evaluate(arguments)


if __name__ == "__main__":
    main()
