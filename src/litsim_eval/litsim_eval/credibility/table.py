"""The table of credibility on a terminal: people first, then a row for each setup, of all encounters and by kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from litsim_eval.credibility.measures import measured
from litsim_eval.credibility.results import PEOPLE, Results
from litsim_eval.report.wording import NOTHING, number

Figures = Mapping[str, Any]
LEGEND = (
    "medians, behind them the distance of the distribution from people's (KS, 0 to 1); position error: mean over the "
    "5 s after the onset along the road; near misses: gap below 1 m or TTC below 1.5 s; AUC: how well they are ranked, "
    "0.5 is chance; taken over: of people the share that reacted"
)


@dataclass(frozen=True)
class Column:
    """A column of the table.

    Attributes:
        head: with the unit.
        text: of the figures of a setup.
        of_people: the same of people's own figures.
    """

    head: str
    text: Callable[[Figures], str]
    of_people: Callable[[Figures], str]


def _number(name: str, digits: int = 2) -> Callable[[Figures], str]:
    return lambda figures: number(figures.get(name), digits)


def _share(name: str) -> Callable[[Figures], str]:
    return lambda figures: NOTHING if figures.get(name) is None else f"{100 * figures[name]:.0f}"


def _nothing(_: Figures) -> str:
    return NOTHING


def _with_distance(head: str, quantity: str, unit: str, digits: int) -> Column:
    """Returns the column of a quantity: its median, and the distance of its distribution from people's."""
    median, distance = _number(f"{quantity}_{unit}", digits), _number(f"{quantity}_ks")
    return Column(head, lambda figures: f"{median(figures)} ({distance(figures).removeprefix('0')})", median)


COLUMNS = (
    Column("taken\nover, %", _share("taken_over"), _share("reacted")),
    Column("position\nerror, m", _number("position_error_m"), _nothing),
    Column("onset\nerror, s", _number("onset_error_s", 1), _nothing),
    _with_distance("onset, s", "onset", "s", 1),
    _with_distance("braking,\nm/s²", "strongest_braking", "mps2", 2),
    _with_distance("least\ngap, m", "least_gap", "m", 1),
    Column("TTC below\n2 s, %", _share("ttc_below_2"), _share("ttc_below_2")),
    Column("near\nmisses, %", _share("near_misses"), _share("near_misses")),
    Column("AUC", _number("near_miss_auc"), _nothing),
    Column("contacts", _number("contacts"), _number("contacts")),
)

MORE_COLUMNS = (
    _with_distance("speed\nlost, m/s", "speed_lost", "mps", 1),
    _with_distance("least\nTTC, s", "least_ttc", "s", 1),
    Column("kappa", _number("wide_kappa"), _nothing),
    Column("politeness, m", _number("politeness_m", 1), _nothing),
    Column("heroism, %", _share("heroism"), _nothing),
)
"""Columns for which terminals lack the room."""


def table_of(results: Results) -> Table:
    """Returns the table of all encounters, then of each kind if there are several."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("driven by", no_wrap=True)
    for column in COLUMNS:
        table.add_column(column.head, justify="right", vertical="bottom")
    for title, rows in sections(results, COLUMNS):
        table.add_section()
        table.add_row(f"[bold]{title}[/bold]")
        for name, cells in rows:
            table.add_row(name, *cells)
    return table


def sections(results: Results, columns: Sequence[Column]) -> Iterator[tuple[str, list[tuple[str, list[str]]]]]:
    """Yields the parts of a table with these columns: a title, and the name and the cells of each row."""
    figures = {PEOPLE: measured(results.people, bounds=False), **results.measures}
    kinds = list(figures[PEOPLE]["kinds"])
    yield _section("all encounters" if len(kinds) > 1 else words(kinds[0]), figures, columns)
    for kind in kinds if len(kinds) > 1 else ():
        of_kind = {name: own["kinds"][kind] for name, own in figures.items() if kind in own["kinds"]}
        yield _section(words(kind), of_kind, columns)


def _section(
    title: str, figures: Mapping[str, Figures], columns: Sequence[Column]
) -> tuple[str, list[tuple[str, list[str]]]]:
    """Returns the part called `title`, with a row for each setup of `figures`."""
    count = figures[PEOPLE]["encounters"]
    rows = [
        (name, [(column.of_people if name == PEOPLE else column.text)(own) for column in columns])
        for name, own in figures.items()
    ]
    return f"{title} ({count})", rows


def words(kind: str) -> str:
    """Returns the name of a kind of encounter in words."""
    return kind.replace("_", " ")
