"""`analyze BAG`: compute the measures of a recorded run, on the terminal and as files beside the bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from litsim_eval.report.analyze import FILES, measure
from litsim_eval.report.terminal import print_ledger, print_metrics
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import RUN_STATUS_HELP, program, run_status
from litsim_sim.record.run import read_run


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval analyze``."""
    p = Parser(prog="analyze", description=__doc__, epilog=f"Files: {', '.join(FILES)}. {RUN_STATUS_HELP}")
    p.add_argument("bag", type=Path, help="folder of a run, or its MCAP file")
    p.add_argument("--out", type=Path, metavar="FOLDER", help="default: beside the bag")
    p.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return p


@program
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval analyze``."""
    arguments = parser().parse_args(argv)
    run = read_run(arguments.bag)
    metrics = measure(run, arguments.out or run.path.parent)
    if not arguments.quiet:
        print_metrics(metrics)
        print_ledger(metrics, run.info.ego_id)
    return run_status(metrics, arguments.bag)
