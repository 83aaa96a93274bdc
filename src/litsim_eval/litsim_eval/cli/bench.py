"""`bench`: measure a step in process and over the graph, by stage, and the start of a run."""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
from functools import partial
from pathlib import Path

from rich.console import Console
from tqdm import tqdm

from litsim_eval.benchmark.steps import measure, table_rows, time_highway_env
from litsim_eval.report.terminal import figures_table
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import program
from litsim_sim.io.files import write_text

HIGHWAY_ENV_MOST = 250  # with more vehicles highway-env takes minutes
HIGHWAY_ENV_STEPS = 20


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
    return p


@program
def main() -> None:
    """Runs ``ros2 run litsim_eval bench``."""
    arguments = parser().parse_args()
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
    show(
        f"a step, median (minimum to maximum) of {arguments.repeats} repetitions, {os.cpu_count()} CPU cores, "
        f"Python {platform.python_version()}",
        [["", *(f"{agents} agents" for agents in samples)], *table_rows(samples)],
        arguments.markdown,
    )


def show(title: str, rows: list[list[str]], markdown: Path | None) -> None:
    """Prints a table, whose head is the first of its rows, and writes it to the file `markdown` unless that is None."""
    head, *body = rows
    Console(width=160).print(figures_table(head, body, title=title, title_justify="left"))
    if markdown is not None:
        rule = ["---", *["---:"] * (len(head) - 1)]
        lines = [title + ".", "", *(f"| {' | '.join(row)} |" for row in (head, rule, *body))]
        write_text(markdown, "\n".join(lines) + "\n")
