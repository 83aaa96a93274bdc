"""`bench`: measure a step in process and over the graph, or throughput, memory or the start-up."""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_eval.benchmark.memory import measure_memory, memory_rows
from litsim_eval.benchmark.start import measure_start, start_rows
from litsim_eval.benchmark.steps import measure, table_rows, time_highway_env
from litsim_eval.benchmark.throughput import measure_throughput, throughput_rows
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import at_least_one, program
from litsim_sim.io.files import replacing

HIGHWAY_ENV_MOST = 250  # with more vehicles highway-env takes minutes
HIGHWAY_ENV_STEPS = 20

Content = tuple[str, Sequence[str], Iterable[Sequence[str]]]
"""Title, head and rows of a table."""


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval bench``."""
    p = Parser(prog="bench", description=__doc__, formatter_class=DefaultsFormatter)
    p.add_argument("--agents", type=int, nargs="+", default=[50, 150, 250, 1000], help="numbers of agents")
    p.add_argument("--seconds", type=float, default=13.0, help="simulated time of a run, 3 s of history included")
    p.add_argument("--repeats", type=int, default=5, help="repetitions, each in process and then over the graph")
    p.add_argument("--apart", action="store_true", help="over the graph, one process per node")
    p.add_argument("--markdown", type=Path, metavar="FILE", help="write the table to this file as well")
    p.add_argument(
        "--highway-env",
        type=Path,
        metavar="FOLDER",
        help="compare with highway-env: folder of step_time.py and its .venv (`make bench` sets it up)",
    )
    p.add_argument("--throughput", action="store_true", help="measure the throughput of `evaluate` and `train`")
    p.add_argument(
        "--beside", type=Path, metavar="CHECKOUT", help="with --throughput: alternate with another, built checkout"
    )
    p.add_argument("--scenario", nargs="+", default=["demo"], help="with --throughput: scenarios to evaluate")
    p.add_argument("--ego-id", help="with --throughput: vehicles that are the ego, as for `evaluate`")
    p.add_argument("--processes", type=at_least_one, default=2, help="with --throughput: processes of `evaluate`")
    p.add_argument(
        "--memory", type=float, metavar="MINUTES", help="measure memory growth in a run of this much simulated time"
    )
    p.add_argument(
        "--start",
        action="store_true",
        help="measure the time from the launcher's start to the first step, and the slowest imports",
    )
    return p


@program
def main() -> None:
    """Runs ``ros2 run litsim_eval bench``."""
    arguments = parser().parse_args()
    if arguments.memory is not None:
        content = memory_table(arguments)
    elif arguments.start:
        content = start_table(arguments)
    else:
        content = throughput_table(arguments) if arguments.throughput else run_table(arguments)
    show(*content, arguments.markdown)


def show(title: str, head: Sequence[str], body: Iterable[Sequence[str]], markdown: Path | None) -> None:
    """Prints a table, and writes it to the file `markdown` unless that is None."""
    title = f"{title}, {os.cpu_count()} CPU cores, Python {platform.python_version()}"
    rows = list(body)
    table = Table(title=title, title_justify="left")
    for k, each in enumerate(head):
        table.add_column(each, justify="right" if k else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    Console(width=160).print(table)
    if markdown is not None:
        rule = ["---", *["---:"] * (len(head) - 1)]
        lines = [title + ".", "", *(f"| {' | '.join(row)} |" for row in (head, rule, *rows))]
        with replacing(markdown) as new:
            new.write_text("\n".join(lines) + "\n", encoding="utf-8")


def run_table(arguments: argparse.Namespace) -> Content:
    """Returns the time of a step by number of agents."""
    samples = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        tqdm(total=arguments.repeats * len(arguments.agents), unit="repetition", dynamic_ncols=True) as bar,
    ):
        for agents in arguments.agents:
            beside = None
            if arguments.highway_env is not None and agents <= HIGHWAY_ENV_MOST:
                python, script = arguments.highway_env / ".venv/bin/python", arguments.highway_env / "step_time.py"
                beside = partial(time_highway_env, python.absolute(), script, steps=HIGHWAY_ENV_STEPS)
            settings = (Path(folder), agents, arguments.seconds, arguments.repeats, beside, bar.update)
            samples[agents] = measure(*settings, ["--apart"] if arguments.apart else [])
    title = f"a step, median (minimum to maximum) of {arguments.repeats} repetitions"
    return title, ["", *(f"{agents} agents" for agents in samples)], table_rows(samples)


def memory_table(arguments: argparse.Namespace) -> Content:
    """Returns the memory of a long run by process."""
    agents, minutes = arguments.agents[0], arguments.memory
    head = ["resident memory, MB", "step 0", "after a quarter", "at the end", "growth since, MB per simulated minute"]
    return f"a run of {minutes:g} min, {agents} agents", head, memory_rows(measure_memory(agents, minutes), minutes)


def start_table(arguments: argparse.Namespace) -> Content:
    """Returns the start-up time of a run."""
    agents, repeats = arguments.agents[0], arguments.repeats
    with tempfile.TemporaryDirectory() as folder, tqdm(total=repeats, unit="repetition", dynamic_ncols=True) as bar:
        starts = measure_start(Path(folder), agents, repeats, bar.update)
    title = f"the start of a run, {agents} agents, {repeats} repetitions"
    return title, ["", "median (minimum to maximum)"], start_rows(starts)


def throughput_table(arguments: argparse.Namespace) -> Content:
    """Returns the throughput of evaluation and training."""
    a = arguments
    with tempfile.TemporaryDirectory() as folder, tqdm(total=a.repeats, unit="pair", dynamic_ncols=True) as bar:
        samples = measure_throughput(Path(folder), a.beside, a.scenario, a.ego_id, a.processes, a.repeats, bar.update)
    title = f"throughput, median (minimum to maximum) of {a.repeats} repetitions"
    return title, ["", *samples], throughput_rows(samples)


if __name__ == "__main__":
    main()
