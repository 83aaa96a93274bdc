"""A run on the terminal: the measures with a title, contacts of the ego, and takeovers."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from litsim_eval.analysis.measures.standoff import standoff_text
from litsim_eval.analysis.measures.timing import pace_text
from litsim_eval.report.events import EventTable, contact_table, takeover_table
from litsim_eval.report.wording import NOTHING, lockstep_text, measured
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.stages import RunEnd

WIDTH = 140  # characters per line of what is not printed to a terminal


def console_of(width: int = WIDTH) -> Console:
    """Returns the console of standard output, of `width` characters per line if that is no terminal."""
    return Console(width=None if sys.stdout.isatty() else width)


def figures_table(head: Sequence[str], rows: Iterable[Sequence[str]], **options: Any) -> Table:
    """Returns a table with names in the first column, where long ones are folded, and figures in the others."""
    table = Table(box=None, pad_edge=False, **options)
    for number, name in enumerate(head):
        table.add_column(name, justify="right" if number else "left", no_wrap=number > 0, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def print_metrics(metrics: dict[str, Any]) -> None:
    """Prints the measures that have a title."""
    title = "{run_id}: {scenario}, ego {ego}, policy {policy}, seed {seed}".format(**metrics)
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, value in _rows(metrics):
        table.add_row(Text(name), Text(value))
    Console().print(table)


def print_ledger(metrics: dict[str, Any], ego: int) -> None:
    """Prints every contact of the vehicle `ego` that has a verdict, and every takeover, as the page has them."""
    contacts = contact_table(metrics, STEP_S, ego)
    judged = EventTable(contacts.head, tuple(row for row in contacts.rows if NOTHING not in row.cells))
    takeovers = takeover_table(metrics["ledger"], STEP_S, ego)
    for title, events in (("contacts of the ego", judged), ("takeovers", takeovers)):
        if events.rows:
            table = Table(*events.head, title=title, title_justify="left", box=None, pad_edge=False)
            for row in events.rows:
                table.add_row(*row.cells)
            Console().print("", table)


def _rows(metrics: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "valid", "yes" if metrics["valid"] else f"NO: {metrics['why']}"
    end = RunEnd.of_plain(metrics["ended"])
    yield "ended", NOTHING if end is None else f"at {metrics['ended']['time_s']:.1f} s: {end.sentence}"
    yield from measured(metrics)
    yield from (("standoff", standoff_text(standoff)) for standoff in metrics.get("standoffs", []))
    if slow := pace_text(metrics):
        yield "pace", slow
    yield "lock-step", lockstep_text(metrics["lockstep"])
    stages = (f"{stage} {t['median']:.1f}/{t['max']:.1f}" for stage, t in metrics["timing"]["stage_ms"].items())
    yield "stages, median/max ms", ", ".join(stages) or NOTHING
    yield "digest", metrics["digest"][:16]
    if metrics.get("seal"):
        yield "seal", metrics["seal"]
