"""`rerun BAG`: repeat one stage or the whole run from the record, or play it into a stack, and compare."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from litsim_eval.runs.recorded_run import open_record
from litsim_eval.runs.rerun import STAGES, rerun_stage, resimulate
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import EXIT_FAILED, InputError
from litsim_sim.io.files import write_json

SHOWN = 5  # most fields in the summary of a difference


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval rerun``."""
    p = Parser(prog="rerun", description=__doc__, usage="rerun [options] BAG [-- COMMAND ...]")
    p.add_argument("bag", type=Path, metavar="BAG", help="folder of a run, or its MCAP file")
    kind = p.add_mutually_exclusive_group(required=True)
    kind.add_argument(
        "--node", metavar="STAGE", help=f"feed a stage its recorded inputs, and compare: {', '.join(STAGES)}"
    )
    kind.add_argument("--resimulate", action="store_true", help="simulate the run again from the bag, and compare")
    kind.add_argument(
        "--to-stack",
        action="store_true",
        help="play the run into a stack, open loop, and compare its commands with the recorded ones",
    )
    stack = p.add_argument_group("with --to-stack, and after -- the command that starts the stack")
    stack.add_argument("--out", type=Path, metavar="FOLDER", help="for the record with the stack's answers")
    stack.add_argument("--overwrite", action="store_true", help="replace an existing record")
    p.add_argument("--json", type=Path, metavar="FILE", help="write the result to this file")
    return p


def rerun(arguments: argparse.Namespace) -> bool:
    """Repeats a stage or the run, prints the result, and returns whether it is equal to the record.

    Raises:
        InputError: the record cannot be used, or the file cannot be written.
    """
    with open_record(arguments.bag) as record:
        run_id = record.run.info.run_id
        report: dict[str, Any] = {"run_id": run_id}
        if arguments.resimulate:
            result = resimulate(record)
            tally, equal = result.tally, result.recorded == result.computed and not result.tally.different
            report |= {"steps": result.steps, "digest_recorded": result.recorded, "digest_computed": result.computed}
            lines = [f"run {run_id}: {result.steps} steps repeated: {'equal' if equal else 'DIFFERENT'}"]
            lines += [f"digest recorded {result.recorded}", f"       computed {result.computed}"]
        else:
            tally = rerun_stage(record, arguments.node)
            equal = not tally.different
            report |= {"stage": arguments.node}
            verdict = "equal" if equal else f"DIFFERENT, {tally.different} of them"
            lines = [f"{arguments.node}: {tally.compared} answers compared with the record: {verdict}"]
        notes = record.notes
    report |= {"equal": equal, "notes": notes} | asdict(tally)
    if tally.first is not None:
        largest = sorted(tally.largest.items(), key=lambda entry: -entry[1])[:SHOWN]
        lines += [f"first: {tally.first}", *(f"largest: {name} by {amount:.3g}" for name, amount in largest)]
    print(*(f"note: {note}" for note in notes), *lines, sep="\n")
    if arguments.json is not None:
        write_json(arguments.json, report)
    return equal


def play(arguments: argparse.Namespace) -> bool:
    """Plays the record into a stack, prints how its commands differ, and returns whether it has answered.

    Raises:
        InputError: the record cannot be used, the stack cannot be started, or the file cannot be written.
    """
    from litsim_eval.runs.open_loop import OpenLoopFailed, play_into, sentence  # the launcher takes half a second

    if arguments.out is None or not arguments.command:
        raise InputError("--to-stack: expected --out FOLDER, and after -- the command that starts the stack")
    try:
        result = play_into(arguments.bag, arguments.command, arguments.out, overwrite=arguments.overwrite)
    except OpenLoopFailed:
        return False
    print(f"{arguments.out}: {sentence(result)}")
    if arguments.json is not None:
        parts = {name: value if isinstance(value, int) else value and asdict(value) for name, value in result.items()}
        write_json(arguments.json, parts)
    return True


@program
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval rerun``."""
    given = sys.argv[1:] if argv is None else argv
    end = given.index("--") if "--" in given else len(given)
    arguments = parser().parse_args(given[:end])
    arguments.command = given[end + 1 :]
    if not arguments.to_stack and (arguments.command or arguments.out is not None or arguments.overwrite):
        raise InputError("--out, --overwrite and a command after --: expected only with --to-stack")
    return 0 if (play if arguments.to_stack else rerun)(arguments) else EXIT_FAILED
