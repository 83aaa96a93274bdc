"""`credibility`: how agents react in recorded encounters whose outcome is hidden, beside what people did there."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from tqdm import tqdm

from litsim_eval.campaign.case import file_digest, variants
from litsim_eval.cli.evaluate import ExamplesFormatter
from litsim_eval.cli.suite_arguments import add_policy_arguments, background_suite
from litsim_eval.credibility.evidence import SUMS_FILE, TEXT_FILE, changes, write_evidence
from litsim_eval.credibility.page import PAGE_FILE, write_page
from litsim_eval.credibility.reading import Selection, encounters_in, packaged_encounters
from litsim_eval.credibility.results import CSV_FILE, JSON_FILE, Results, write_csv
from litsim_eval.credibility.running import EGO, DriveOrReason, RunKey, Setup, Task, run_task
from litsim_eval.credibility.table import LEGEND, table_of
from litsim_eval.report.terminal import console_of
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import at_least_one, interrupt_on_signals, program
from litsim_sim.core.errors import EXIT_FAILED, print_error
from litsim_sim.core.installation import command
from litsim_sim.core.parameters import by_place
from litsim_sim.io.files import write_json
from litsim_sim.scenario.encounter_note import SPLITS
from litsim_sim.scenario.policies import installed_setups
from litsim_sim.simulation import configured

STATUS_HELP = (
    "Exit status: 0; 1, a policy has no run with a result, or an evidence pack has changed; 2, bad input; 130, "
    "interrupted."
)
EXAMPLES = """examples:
  credibility
      the packaged encounters, with policies litsim, yield and idm
  credibility --recording mine.yaml --policy litsim --out bags/credibility
      encounters in a recording of yours, with a page
  credibility --policy litsim --set policy.weights=critic policy.rules=false
      a network without the rules

"""
POLICIES = ["litsim", "yield", "idm"]
REASONS_MAX = 5  # most runs without a result that are printed with their reasons


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval credibility``."""
    p = Parser(
        prog="credibility", description=__doc__, epilog=EXAMPLES + STATUS_HELP, formatter_class=ExamplesFormatter
    )
    p.add_argument(
        "--recording",
        metavar="PATH",
        help="folder of encounters, one of them, or a scenario or recording in which to find some; default: the "
        "packaged ones, built from LITSIM_DATA",
    )
    p.add_argument(
        "--split",
        choices=SPLITS,
        help="encounters of this part; default: reported ones of the packaged, all of a recording",
    )
    p.add_argument("--limit", type=at_least_one, metavar="N", help="only so many, spread evenly")
    add_policy_arguments(p, POLICIES)
    p.add_argument(
        "--drivers",
        type=at_least_one,
        default=1,
        metavar="N",
        help="draws of the drivers in each encounter; policy litsim draws them from 2 on",
    )
    p.add_argument("--json", type=Path, metavar="FILE", help="write the measures to this file")
    p.add_argument("--out", type=Path, metavar="DIR", help=f"write a page, {JSON_FILE} and {CSV_FILE} to this folder")
    p.add_argument(
        "--evidence", type=Path, metavar="DIR", help="write an evidence pack for an assessment of credibility there"
    )
    p.add_argument("--check", type=Path, metavar="DIR", help="only say what has changed in an evidence pack")
    p.add_argument("--processes", type=at_least_one, default=2, help="number of processes")
    return p


def credibility(arguments: argparse.Namespace) -> int:
    """Drives the encounters that the arguments describe, tells how, and returns the exit status.

    Raises:
        InputError: an argument or a file cannot be used; raised before the first run.
    """
    if arguments.check is not None:
        return _check(arguments.check)
    setups = setups_of(arguments)
    selection = selection_of(arguments)
    task = Task(selection.encounters, setups, arguments.drivers)
    results = Results.of(task, _driven(task, arguments.processes))
    written = _write(results, selection, arguments)
    _print(results)
    for line in written:
        print(line)
    return EXIT_FAILED if len(results.responses) < len(setups) else 0


def _driven(task: Task, processes: int) -> Iterator[tuple[RunKey, DriveOrReason]]:
    """Yields the runs of `task` with their outcomes, with a progress bar."""
    with (
        tqdm(total=len(task), unit="run", dynamic_ncols=True) as bar,
        closing(run_task(task, processes)) as running,
    ):
        for outcome in running:
            yield outcome
            bar.update()


def _write(results: Results, selection: Selection, arguments: argparse.Namespace) -> list[str]:
    """Writes the files that the arguments ask for, and returns lines on where they are."""
    lines = []
    if arguments.json is not None:
        write_json(arguments.json, results.to_json())
    typed = shlex.join([command(), "credibility", *sys.argv[1:]])
    for folder in filter(None, (arguments.out, arguments.evidence)):
        write_json(folder / JSON_FILE, results.to_json())
        write_csv(results, folder / CSV_FILE)
        write_page(results, typed, folder / PAGE_FILE)
        lines.append(f"page: {folder / PAGE_FILE}")
    if arguments.evidence is not None:
        digest = write_evidence(results, selection.files, typed, arguments.evidence)
        lines.append(
            f"evidence: {arguments.evidence / TEXT_FILE}; SHA-256 of {SUMS_FILE}, to be kept elsewhere: {digest}"
        )
    return lines


def selection_of(arguments: argparse.Namespace) -> Selection:
    """Returns the encounters that the arguments describe.

    Raises:
        InputError: there is none, or a file cannot be used.
    """
    if arguments.recording is None:
        return packaged_encounters(arguments.split, arguments.limit)
    return encounters_in(arguments.recording, arguments.split, arguments.limit)


def setups_of(arguments: argparse.Namespace) -> tuple[Setup, ...]:
    """Returns what drives: each policy with each combination of parameters.

    Raises:
        InputError: a policy or a parameter is unknown, or a value is invalid.
    """
    setups = []
    for variant in variants(background_suite(arguments, EGO)):
        own = variant.label.split(", ")[0] in installed_setups()  # the label begins with the name of the setup
        name = ", ".join(part for part in ("" if own else variant.policy, variant.label) if part)
        parameters = by_place(variant.parameters)
        configured(EGO, variant.policy, parameters)
        setups.append(Setup(name, variant.policy, parameters))
    return tuple(setups)


def _check(folder: Path) -> int:
    """Says what has changed in the evidence pack in `folder`, and returns the exit status."""
    different = changes(folder)
    for change in different:
        print(f"{folder}: {change}", file=sys.stderr)
    if not different:
        print(f"{folder}: all files are as written; SHA-256 of {SUMS_FILE}: {file_digest(folder / SUMS_FILE)}")
    return EXIT_FAILED if different else 0


def _print(results: Results) -> None:
    """Prints the table, and runs without a result with their reasons."""
    console = console_of(150)
    console.print(table_of(results))
    console.print(LEGEND, soft_wrap=False, highlight=False)
    for failure in results.failures[:REASONS_MAX]:
        print_error(f"{failure.setup}, {failure.encounter}: {failure.reason}")
    if len(results.failures) > REASONS_MAX:
        print_error(f"and {len(results.failures) - REASONS_MAX} more runs without a result")


@program
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval credibility``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    try:
        return credibility(arguments)
    except KeyboardInterrupt:
        print("\ninterrupted: nothing is written", file=sys.stderr)
        raise
