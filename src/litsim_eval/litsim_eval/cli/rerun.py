"""`rerun BAG`: repeat one stage, or the whole run, from the record, and compare."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from litsim_eval.runs.recorded_run import open_record
from litsim_eval.runs.rerun import STAGES, rerun_stage, resimulate
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import EXIT_FAILED, InputError

SHOWN = 5  # most fields in the summary of a difference


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval rerun``."""
    p = Parser(prog="rerun", description=__doc__)
    p.add_argument("bag", type=Path, metavar="BAG", help="folder of a run, or its MCAP file")
    kind = p.add_mutually_exclusive_group(required=True)
    kind.add_argument(
        "--node", metavar="STAGE", help=f"feed a stage its recorded inputs, and compare: {', '.join(STAGES)}"
    )
    kind.add_argument("--resimulate", action="store_true", help="simulate the run again from the bag, and compare")
    p.add_argument("--json", type=Path, metavar="FILE", help="write the result to this file")
    return p


def rerun(arguments: argparse.Namespace) -> bool:
    """Repeats a stage or the run, prints the result, and returns whether it is equal to the record.

    Raises:
        InputError: the record cannot be used, or the file cannot be written.
    """
    with open_record(arguments.bag) as record:
        report: dict[str, Any] = {"run_id": record.info.run_id}
        if arguments.resimulate:
            result = resimulate(record)
            tally, equal = result.tally, result.recorded == result.computed and not result.tally.different
            report |= {"steps": result.steps, "digest_recorded": result.recorded, "digest_computed": result.computed}
            lines = [f"run {record.info.run_id}: {result.steps} steps repeated: {'equal' if equal else 'DIFFERENT'}"]
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
    if arguments.json:
        try:
            arguments.json.write_text(json.dumps(report, indent=2) + "\n")
        except OSError as error:
            raise InputError(f"{arguments.json}: cannot be written: {error.strerror or error}") from error
    return equal


@program
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval rerun``."""
    arguments = parser().parse_args(argv)
    return 0 if rerun(arguments) else EXIT_FAILED


if __name__ == "__main__":
    main()
