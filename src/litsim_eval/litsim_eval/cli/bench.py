"""`bench`: measure a step in process and over the graph, or throughput, memory or the start-up."""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
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


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_eval bench``."""
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
    p.add_argument("--egos", default="egos", help="with --throughput: egos, as for `evaluate`")
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
    """Entry point of ``ros2 run litsim_eval bench``."""
    arguments = parser().parse_args()
    if arguments.memory is not None:
        show(*memory_table(arguments.agents[0], arguments.memory), arguments.markdown)
    elif arguments.start:
        show(*start_table(arguments.agents[0], arguments.repeats), arguments.markdown)
    elif arguments.throughput:
        show(*throughput_table(arguments), arguments.markdown)
    else:
        show(*run_table(arguments), arguments.markdown)


def show(title: str, head: list[str], rows: list[list[str]], markdown: Path | None) -> None:
    """Print a table, and write it to the file `markdown` unless that is None."""
    table = Table(title=title, title_justify="left")
    for k, each in enumerate(head):
        table.add_column(each, justify="right" if k else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    Console(width=160).print(table)
    if markdown is not None:
        lines = [
            title + ".",
            "",
            *(f"| {' | '.join(row)} |" for row in (head, ["---", *["---:"] * (len(head) - 1)], *rows)),
        ]
        with replacing(markdown) as new:
            new.write_text("\n".join(lines) + "\n", encoding="utf-8")


def run_table(arguments: argparse.Namespace) -> tuple[str, list[str], list[list[str]]]:
    """Whole runs by number of agents: title, head and rows."""
    found = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        tqdm(total=arguments.repeats * len(arguments.agents), unit="repetition", dynamic_ncols=True) as bar,
    ):
        for agents in arguments.agents:
            beside = None
            if arguments.highway_env is not None and agents <= HIGHWAY_ENV_MOST:
                python, script = arguments.highway_env / ".venv/bin/python", arguments.highway_env / "step_time.py"
                beside = partial(time_highway_env, python.absolute(), script, steps=HIGHWAY_ENV_STEPS)
            given = (Path(folder), agents, arguments.seconds, arguments.repeats, beside, bar.update)
            found[agents] = measure(*given, ["--apart"] if arguments.apart else [])
    title = f"a step, median (minimum to maximum) of {arguments.repeats} repetitions, {_machine()}"
    return title, ["", *(f"{agents} agents" for agents in found)], [list(row) for row in table_rows(found)]


def memory_table(agents: int, minutes: float) -> tuple[str, list[str], list[list[str]]]:
    """Memory of a long run by process: title, head and rows."""
    head = ["resident memory, MB", "step 0", "after a quarter", "at the end", "growth since, MB per simulated minute"]
    found = measure_memory(agents, minutes)
    return f"a run of {minutes:g} min, {agents} agents, {_machine()}", head, list(memory_rows(found, minutes))


def start_table(agents: int, repeats: int) -> tuple[str, list[str], list[list[str]]]:
    """Start-up time of a run: title, head and rows."""
    with tempfile.TemporaryDirectory() as folder, tqdm(total=repeats, unit="repetition", dynamic_ncols=True) as bar:
        found = measure_start(Path(folder), agents, repeats, bar.update)
    title = f"the start of a run, {agents} agents, {repeats} repetitions, {_machine()}"
    return title, ["", "median (minimum to maximum)"], list(start_rows(found))


def throughput_table(arguments: argparse.Namespace) -> tuple[str, list[str], list[list[str]]]:
    """Throughput of evaluation and training: title, head and rows."""
    with (
        tempfile.TemporaryDirectory() as folder,
        tqdm(total=arguments.repeats, unit="pair", dynamic_ncols=True) as bar,
    ):
        found = measure_throughput(
            Path(folder),
            arguments.beside,
            arguments.scenario,
            arguments.egos,
            arguments.processes,
            arguments.repeats,
            bar.update,
        )
    title = f"throughput, median (minimum to maximum) of {arguments.repeats} repetitions, {_machine()}"
    return title, ["", *found], list(throughput_rows(found))


def _machine() -> str:
    return f"{os.cpu_count()} CPU cores, Python {platform.python_version()}"


if __name__ == "__main__":
    main()
