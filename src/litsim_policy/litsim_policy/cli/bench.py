"""`bench`: time per step in process and over the graph, or of conflict detection alone, by number of agents."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_policy.run.benchmark import measure, rows
from litsim_policy.run.conflict_benchmark import detection_rows, measure_detection
from litsim_sim.core.errors import InputError

TITLES = {
    "in_process": "in process, ms/step",
    "graph": "graph with recording, ms/step",
    "ratio": "ratio",
    "realtime_factor": "graph, x real time",
}
DETECTION_TITLES = ("agents", "off their logs", "pairs", "conflicts", "wall ms, median (min to max)", "CPU ms")
DETECTION_REPEATS = 200


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_policy bench``."""
    p = argparse.ArgumentParser(
        prog="bench", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    p.add_argument("--agents", type=int, nargs="+", default=[10, 50, 100, 250], help="numbers of agents, at most 250")
    p.add_argument("--seconds", type=float, default=13.0, help="simulated time of a run, 3 s of history included")
    p.add_argument("--repeats", type=int, default=3, help="pairs of runs for each number of agents")
    p.add_argument("--conflicts", action="store_true", help="conflict detection alone, over 50 steps of horizon")
    return p


def main() -> None:
    """Entry point of ``ros2 run litsim_policy bench``."""
    arguments = parser().parse_args()
    Console(width=120).print(detection_table(arguments.agents) if arguments.conflicts else run_table(arguments))


def detection_table(numbers: list[int]) -> Table:
    """Conflict detection by number of agents."""
    table = Table(title=f"conflict detection, {DETECTION_REPEATS} times, {os.cpu_count()} CPU cores")
    for title in DETECTION_TITLES:
        table.add_column(title, justify="right")
    for agents in numbers:
        table.add_row(*detection_rows(measure_detection(agents, DETECTION_REPEATS)))
    return table


def run_table(arguments: argparse.Namespace) -> Table:
    """Whole runs by number of agents."""
    table = Table(title=f"median (min to max) of {arguments.repeats} pairs of runs, {os.cpu_count()} CPU cores")
    table.add_column("agents", justify="right")
    for title in TITLES.values():
        table.add_column(title, justify="right")
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            tqdm(total=2 * arguments.repeats * len(arguments.agents), unit="run", dynamic_ncols=True) as bar,
        ):
            for agents in arguments.agents:
                samples = measure(Path(folder), agents, arguments.seconds, arguments.repeats, bar.update)
                table.add_row(str(agents), *(text for _, text in rows(samples)))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    return table


if __name__ == "__main__":
    main()
