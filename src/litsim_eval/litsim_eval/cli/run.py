"""`run`: one run in this process, without ROS, with the same metrics as a recorded run."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tqdm import tqdm

from litsim_eval.analysis.metrics import compute_metrics, write_metrics
from litsim_eval.report.analyze import measure
from litsim_eval.report.run_report import REPORT_FILE, render
from litsim_eval.report.terminal import print_metrics
from litsim_eval.runs.in_process import record
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import RUN_STATUS_HELP, interrupt_on_signals, program, run_status
from litsim_sim.cli.run_arguments import add_run_arguments, plan_of
from litsim_sim.io.files import write_text
from litsim_sim.launch.output import check_output
from litsim_sim.scenario.run_info import driver_names
from litsim_sim.world.sumo import SumoMirror


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval run``."""
    p = Parser(prog="run", description=__doc__, epilog=RUN_STATUS_HELP, formatter_class=DefaultsFormatter)
    add_run_arguments(p, driver_names())
    p.add_argument("--json", type=Path, help="write the metrics to this file")
    files = "write the metrics, their tables and pictures, and the page report.html into this folder"
    p.add_argument("--out", type=Path, metavar="DIR", help=files)
    return p


def run(arguments: argparse.Namespace) -> int:
    """Makes the run, shows its metrics, and returns the exit status.

    Raises:
        InputError: an argument or a file cannot be used.
    """
    plan = plan_of(arguments)
    if arguments.out is not None:
        check_output(arguments.out, overwrite=False)
    scenario = plan.scenario
    mirror = SumoMirror(scenario.net_path, scenario.seed, scenario.signals)
    with tqdm(total=scenario.total_steps + 1, unit="step", dynamic_ncols=True) as bar:
        recorded = record(plan, mirror, progress=bar.update)
    if arguments.out is None:
        metrics = compute_metrics(recorded)
    else:
        metrics = measure(recorded, arguments.out)
        write_text(arguments.out / REPORT_FILE, render(recorded, metrics))
    if arguments.json:
        write_metrics(metrics, arguments.json)
    print_metrics(metrics)
    return run_status(metrics, plan.scenario.name)


@program
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval run``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    try:
        return run(arguments)
    except KeyboardInterrupt:
        print("\ninterrupted: the run is not measured", file=sys.stderr)
        raise
