"""`search`: find the least changes of what people did with which a stack fails, in every case of a suite."""

from __future__ import annotations

import argparse
import shutil
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from rich.table import Table
from tqdm import tqdm

from litsim_eval.campaign.case import code_versions
from litsim_eval.campaign.criteria import SAFETY, Criteria
from litsim_eval.cli.evaluate import ExamplesFormatter
from litsim_eval.cli.suite_arguments import add_suite_arguments, cases_to_run, refuse_unusable, suite_of
from litsim_eval.report.terminal import console_of, figures_table
from litsim_eval.runs.case_run import TIME_LIMIT_S
from litsim_eval.runs.warm_runs import WarmRuns
from litsim_eval.search.explore import SAMPLERS
from litsim_eval.search.margins import FAILURES_FILE, JUNIT_FILE, PAGE_FILE, Margins, told, write_junit
from litsim_eval.search.people import PARAMETERS, People
from litsim_eval.search.search import RUNS, SCENARIOS, SCREEN, SEARCH_FILE, Search, Settings
from litsim_eval.search.space import LOOK_S
from litsim_sim.cli.arguments import Parser, number, positive
from litsim_sim.cli.program import at_least_one, interrupt_on_signals, program
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.core.parameters import not_among

STATUS_HELP = (
    "Exit status: 0; 1, a scenario fails as recorded or has a margin below --at-least; 2, bad input; 130, interrupted; "
    "the same command resumes it."
)
EXAMPLES = """examples:
  search --scenario demo --ego idm --policy litsim --out bags/margin
      the margin of LitSim's ego idm in one scenario
  search --suite small --case motorway_00 --ego external --out bags/mine -- python3 my_stack.py
      margins of your stack, over DDS
  evaluate --suite bags/mine/failures.yaml --out bags/again
      run the failures that were found again

"""
DEFAULT_OUT = "bags/search"


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval search``."""
    p = Parser(prog="search", description=__doc__, epilog=EXAMPLES + STATUS_HELP, formatter_class=ExamplesFormatter)
    add_suite_arguments(p)
    p.add_argument("--runs", type=at_least_one, default=200, help="most runs in each scenario")
    p.add_argument("--minutes", type=positive, help="time after which no further run begins")
    p.add_argument(
        "--change",
        nargs="+",
        default=[],
        help="kinds of change, or parameters, that may vary; default: all measured ones",
    )
    p.add_argument("--sampler", choices=SAMPLERS, default="tpe", help="what proposes changes")
    p.add_argument("--search-seed", type=int, default=0, help="seed of what is proposed")
    p.add_argument("--people", nargs="+", metavar="SCENARIO", help="recordings that distances are measured by")
    p.add_argument("--save-people", type=Path, metavar="FILE", help="only write what people did there, as YAML")
    p.add_argument("--parameters", action="store_true", help="only list the parameters, and what people did")
    p.add_argument(
        "--at-least", type=number(0.0), default=0.0, metavar="MARGIN", help="margin below which a scenario has failed"
    )
    p.add_argument("--graph", action="store_true", help="run LitSim's own egos over DDS, too")
    p.add_argument(
        "--out", type=Path, default=Path(DEFAULT_OUT), help="folder of the search; an existing one is resumed"
    )
    p.add_argument("--processes", type=at_least_one, default=2, help="number of runs at a time")
    p.add_argument(
        "--time-limit", type=positive, default=TIME_LIMIT_S, metavar="S", help="time limit of a run over DDS [s]"
    )
    p.add_argument("--overwrite", action="store_true", help="replace the search in the folder")
    return p


def search(arguments: argparse.Namespace) -> int:
    """Makes the search that the arguments describe, or the rest of it, and returns the exit status.

    Raises:
        InputError: an argument or a file cannot be used; raised before the first run.
    """
    names = {name for parameter in PARAMETERS for name in (parameter.name, parameter.kind)}
    if unknown := [name for name in arguments.change if name not in names]:
        raise InputError(f"--change {not_among(unknown, sorted(names))}")
    people = People.of(arguments.people) if arguments.people else People.load()
    if arguments.save_people is not None:
        people.write(arguments.save_people)
        print(f"{arguments.save_people}: what people did in {people.source}")
        return 0
    if arguments.parameters:
        _print_parameters(people)
        return 0
    if arguments.suite is None and arguments.policy is None:
        arguments.policy = ["litsim"]
    suite = suite_of(arguments)
    if arguments.criteria is None:
        suite = suite.model_copy(update={"criteria": Criteria.load(SAFETY)})
    versions = code_versions()
    suite, cases = cases_to_run(arguments, suite, versions)
    refuse_unusable(arguments, cases)
    settings = Settings(
        runs=arguments.runs,
        sampler=arguments.sampler,
        seed=arguments.search_seed,
        only=tuple(arguments.change),
        minutes=arguments.minutes,
        processes=arguments.processes,
        time_limit_s=arguments.time_limit,
        graph=arguments.graph,
    )
    with WarmRuns() if arguments.warm else nullcontext() as warm:
        return _searched(arguments, Search(suite, cases, versions, people, replace(settings, warm=warm), arguments.out))


def _searched(arguments: argparse.Namespace, making: Search) -> int:
    """Make the runs of a search, and print what comes of them; returns the exit status."""
    if arguments.overwrite and (arguments.out / SEARCH_FILE).is_file():
        for name in (RUNS, SCENARIOS, SCREEN):
            shutil.rmtree(arguments.out / name, ignore_errors=True)
        (arguments.out / SEARCH_FILE).unlink()
    with tqdm(total=making.runs, unit="run", dynamic_ncols=True) as bar:
        try:
            margins = making.run(bar.update)
        except KeyboardInterrupt:
            print_error("the search ended before all runs were done; the same command resumes it")
            raise
    write_junit(margins, arguments.at_least, arguments.out / JUNIT_FILE)
    _print(margins, arguments.out)
    short = {scenario.name: scenario.short_of(arguments.at_least) for scenario in margins.scenarios}
    for name, text in short.items():
        if text:
            print(f"failed  {name}: {text}", file=sys.stderr)
    return EXIT_FAILED if any(short.values()) else 0


def _print(margins: Margins, out: Path) -> None:
    """Prints the margins, and the nearest failure of each scenario."""
    head = ("scenario", "margin", "runs", "failed", "forced", "errors", "drawn: rate, 95 %")
    rows = []
    for scenario in margins.scenarios:
        margin = "-" if scenario.margin is None else f"{scenario.margin:.2f}"
        counts = map(str, (scenario.runs, scenario.failed, scenario.forced, scenario.errors))
        rate = "-" if scenario.rate is None else f"{100.0 * scenario.rate[0]:.1f} to {100.0 * scenario.rate[1]:.1f} %"
        rows.append((scenario.name, margin, *counts, rate))
    console = console_of()
    console.print(figures_table(head, rows))
    for scenario in margins.scenarios:
        for line in told(scenario.failures[0]) if scenario.failures else scenario.none_up_to(margins.bound):
            console.print(line, markup=False, highlight=False, soft_wrap=True)
    failures = f"; failures: {out / FAILURES_FILE}" if (out / FAILURES_FILE).is_file() else ""
    print(f"margins in standard deviations of what people did; -: no failure that counts up to {margins.bound:g} each")
    print(f"page: {out / PAGE_FILE}{failures}")


def _print_parameters(people: People) -> None:
    """Prints every parameter with its bounds and what people did."""
    table = Table(box=None, pad_edge=False, title=f"what people did: {people.source}", title_justify="left")
    for name in ("parameter", "unit", "bounds", "at 1", "at 2", "at 3", "moments", "what it is"):
        table.add_column(name, no_wrap=name != "what it is")
    for parameter in PARAMETERS:
        habit = people.habit(parameter)
        values = [f"{habit.value(distance):.2f}" for distance in (1.0, 2.0, 3.0)]
        moments = str(habit.moments) if habit.moments else "declared"
        table.add_row(
            parameter.name,
            parameter.unit,
            f"{parameter.low:g} to {parameter.high:g}",
            *values,
            moments,
            parameter.about,
        )
    console_of().print(table)
    rare = ", ".join(f"{act} {rate.distance(LOOK_S):.2f}" for act, rate in people.rates.items())
    print(f"distance of that an agent does it at all within {LOOK_S:g} s: {rare}")


@program
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval search``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    return search(arguments)


if __name__ == "__main__":
    main()
