"""The table of a campaign on a terminal of any width: a line per measure, a column per variant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group, RenderableType
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from litsim_eval.analysis.measure import Row
from litsim_eval.analysis.measure import Table as Shown
from litsim_eval.analysis.metrics import leaves
from litsim_eval.analysis.summary import MARK, mark_of, reached, rows_of
from litsim_eval.campaign.variant_summary import Bounds, DrawnCase

Lines = Mapping[str, Mapping[str, str]]
"""Texts by name of the measure and variant."""


def print_summary(
    title: str,
    summary: Mapping[str, Mapping[str, Any]],
    console: Console,
    *,
    replayed: bool = False,
    everything: bool = True,
    bounds: Mapping[str, Bounds] | None = None,
) -> None:
    """Prints the variants of a campaign side by side.

    If their names are too wide, they are numbered and listed below; if that is still too wide, the variants are divided
    over several tables. Figures measured on only some of the runs are marked.

    Args:
        title: above the table.
        summary: by name of the variant, the result of :func:`litsim_eval.campaign.variant_summary.variant_summary`.
        console: to print to.
        replayed: whether the background is replayed in all variants; measures of agents under control are left out.
        everything: whether measures of the simulation are shown, not only those of the ego.
        bounds: of the figures, by variant, printed behind them.
    """
    tables = (Shown.EGO, Shown.SIMULATION, Shown.TRAFFIC, Shown.DISPLACEMENT) if everything else (Shown.EGO,)
    rows = {variant: leaves(values) for variant, values in summary.items()}
    lines = {
        row.heading: {variant: _text(row, values, (bounds or {}).get(variant, {})) for variant, values in rows.items()}
        for row in rows_of(*tables)
        if not (replayed and row.of_control) and any(values.get(row.name) is not None for values in rows.values())
    }
    named = _table({variant: variant for variant in rows}, lines)
    if _fits(named, console):
        parts: list[RenderableType] = [named]
    else:
        numbers = {variant: str(number) for number, variant in enumerate(rows, 1)}
        parts = [
            *_numbered(numbers, lines, console),
            *(Text(f"{numbers[variant]:>3}  {variant}") for variant in rows),
        ]
    lacking = [f"{variant}: {row['measured']} of {row['runs']}" for variant, row in rows.items() if row["failed"]]
    if lacking:
        parts.append(Text(f"{MARK} over the runs that were measured: " + "; ".join(lacking)))
    console.print(Group(Text(title), *parts))


def print_drawn(cases: Sequence[DrawnCase], most: int, console: Console) -> None:
    """Prints the probability of failure of the first `most` of the `cases` that fail with any driver."""
    failing = [case for case in cases if case.failed]
    table = Table("fails with", "P(fail) %", "case", box=SIMPLE_HEAD, pad_edge=False)
    for case in failing[:most]:
        low, high = (100.0 * bound for bound in case.bounds)
        percent = f"{100.0 * case.probability:.0f} [{low:.0f}, {high:.0f}]"
        table.add_row(f"{case.failed} of {case.drivers} drivers", percent, case.name)
    if failing:
        console.print(table)
    console.print(Text(f"{len(cases) - len(failing)} of {len(cases)} cases pass with all drivers"))


def _numbered(numbers: Mapping[str, str], lines: Lines, console: Console) -> list[Table]:
    """Returns tables with as many variants as fit, but at least one each."""
    count = len(numbers)
    while count > 1 and not all(_fits(table, console) for table in _spread(numbers, lines, count)):
        count -= 1
    return _spread(numbers, lines, count)


def _spread(numbers: Mapping[str, str], lines: Lines, most: int) -> list[Table]:
    """Returns as few tables as possible with at most `most` variants, evenly distributed."""
    variants, tables = list(numbers), -(-len(numbers) // most)
    parts = [variants[len(variants) * i // tables : len(variants) * (i + 1) // tables] for i in range(tables)]
    return [_table({variant: numbers[variant] for variant in part}, lines) for part in parts]


def _fits(table: Table, console: Console) -> bool:
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum <= console.width


def _table(headings: Mapping[str, str], lines: Lines) -> Table:
    """Returns the table of some variants; `headings` are the names of the columns by variant."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    for heading in headings.values():
        table.add_column(heading, justify="right", no_wrap=True)
    for name, texts in lines.items():
        table.add_row(Text(name), *(texts[variant] for variant in headings))
    return table


def _text(row: Row, values: Mapping[str, Any], bounds: Bounds) -> str:
    """Returns the value of a row in a variant, with its bounds, if it has any."""
    value = values.get(row.name)
    between = ""
    if row.name in bounds:
        low, high = (round(bound) if isinstance(value, int) else bound for bound in bounds[row.name])
        between = f" [{_number(row, low)}, {_number(row, high)}]"
    return _number(row, value) + mark_of(row, values) + between + reached(row, values)


def _number(row: Row, value: float | None) -> str:
    if value is None:
        return "-"
    if row.share:
        return f"{100.0 * value:.2f}"
    return str(value) if isinstance(value, int) else f"{value:.3g}"
