"""`compare A B [C...]`: the measures of runs side by side, what differs from the first in yellow."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from litsim_sim.analysis.compare import Comparison, Row, compare, load, names_of
from litsim_sim.cli.program import program

NOTHING = "-"
DIGITS = 5
WIDTH = 140  # of what is not printed to a terminal
TEXT_MAX = 17  # enough to tell digests apart; --json has everything


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_sim compare``."""
    p = argparse.ArgumentParser(prog="compare", description=__doc__)
    p.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folder, MCAP file or metrics.json of a run")
    p.add_argument("--differences", action="store_true", help="only what differs")
    p.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return p


def print_comparison(comparison: Comparison, only_differences: bool = False, console: Console | None = None) -> None:
    """Print a table; wall times are never marked."""
    console = console or Console(width=None if sys.stdout.isatty() else WIDTH)
    two = len(comparison.names) == 2
    table = Table(box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    for name in comparison.names:
        table.add_column(name, justify="right", no_wrap=True)
    if two:
        table.add_column("change", justify="right", no_wrap=True)
    for row in comparison.rows:
        if row.differs or not only_differences:
            marked = row.differs and row.of_the_run
            table.add_row(*_cells(row, two), style=None if row.of_the_run else "dim", end_section=False)
            if marked:
                table.rows[-1].style = "bold yellow"
    console.print(table)
    console.print("equal but for wall times" if comparison.equal else _count(comparison), highlight=False)


def _count(comparison: Comparison) -> str:
    differing = [row for row in comparison.rows if row.differs and row.of_the_run]
    return f"{len(differing)} measures differ"


def _cells(row: Row, with_change: bool) -> list[str]:
    mark = "* " if row.differs and row.of_the_run else "  "  # also without colours
    cells = [mark + row.name, *(_text(value) for value in row.values)]
    if with_change:
        change = row.changes[1]
        cells.append(f"{change:+.{DIGITS}g}" if row.differs and change is not None else "")
    return cells


def _text(value: Any) -> str:
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    text = str(value)
    return text if len(text) <= TEXT_MAX else f"{text[: TEXT_MAX - 1]}…"


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim compare``."""
    p = parser()
    arguments = p.parse_args(argv)
    if len(arguments.runs) < 2:
        p.error("name two runs at least")
    metrics = [load(path) for path in arguments.runs]
    comparison = compare(dict(zip(names_of(arguments.runs), metrics, strict=True)))
    if arguments.json:
        print(json.dumps(comparison.to_json(), indent=2))
    else:
        print_comparison(comparison, arguments.differences)


if __name__ == "__main__":
    main()
