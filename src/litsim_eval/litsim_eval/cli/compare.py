"""`compare A B [C...]`: compare runs, with differences from the first in yellow; or two campaigns, or two searches."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from litsim_eval.analysis.compare import Comparison, Row, compare, load, names_of
from litsim_eval.campaign.comparison import compare_campaigns
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import is_campaign, read_campaign
from litsim_eval.report.campaign_comparison import print_campaigns
from litsim_eval.report.terminal import console_of, figures_table
from litsim_eval.search.margins import Margins, compare_margins, is_search
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import EXIT_FAILED, InputError

NOTHING = "-"
DIGITS = 5
TEXT_MAX = 17  # enough to tell digests apart; --json has everything


STATUS_HELP = (
    "Exit status: 0; of campaigns 1 where a case passed and does not any more; of searches 1 where margins clearly "
    "shrink; 2, bad input."
)


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval compare``."""
    p = Parser(prog="compare", description=__doc__, epilog=STATUS_HELP)
    p.add_argument(
        "runs",
        type=Path,
        nargs="+",
        metavar="RUN",
        help="folder, MCAP file or metrics.json of a run; or the folders of two campaigns, the earlier one first; "
        "or of one, with what it was before something changed; or the folders of two searches",
    )
    p.add_argument("--differences", action="store_true", help="for runs: show only what differs")
    p.add_argument("--all", action="store_true", help="for campaigns: show every measure that differs, and every case")
    p.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return p


def print_comparison(comparison: Comparison, console: Console, *, only_differences: bool) -> None:
    """Prints a table; wall times are never marked."""
    two = len(comparison.names) == 2
    table = Table(box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    for name in comparison.names:
        table.add_column(name, justify="right", no_wrap=True)
    if two:
        table.add_column("change", justify="right", no_wrap=True)
    for row in comparison.rows:
        if row.differs or not only_differences:
            style = "bold yellow" if row.marked else None if row.of_the_run else "dim"
            table.add_row(*_cells(row, two), style=style)
    console.print(table)
    differing = sum(row.marked for row in comparison.rows)
    console.print(f"{differing} measures differ" if differing else "equal but for wall times", highlight=False)


def _cells(row: Row, with_change: bool) -> list[str]:
    mark = "* " if row.marked else "  "  # also without colours
    cells = [mark + row.name, *(_text(value) for value in row.values)]
    if with_change:
        cells.append(f"{row.change:+.{DIGITS}g}" if row.differs and row.change is not None else "")
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
def main(argv: list[str] | None = None) -> int:
    """Runs ``ros2 run litsim_eval compare``."""
    p = parser()
    arguments = p.parse_args(argv)
    if len(arguments.runs) == 1 and is_campaign(arguments.runs[0]):
        earlier = CampaignFolder(arguments.runs[0]).history
        if not earlier:
            raise InputError(f"{arguments.runs[0]}: nothing has changed in this campaign yet, expected a second one")
        arguments.runs = [earlier[-1], arguments.runs[0]]
    if len(arguments.runs) < 2:
        p.error("name two runs at least")
    if any(is_campaign(path) for path in arguments.runs):
        return _campaigns(arguments)
    if any(is_search(path) for path in arguments.runs):
        return _searches(arguments)
    metrics = [load(path) for path in arguments.runs]
    comparison = compare(dict(zip(names_of(arguments.runs), metrics, strict=True)))
    if arguments.json:
        print(json.dumps(comparison.to_json(), indent=2))
    else:
        print_comparison(comparison, console_of(), only_differences=arguments.differences)
    return 0


def _campaigns(arguments: argparse.Namespace) -> int:
    """Compares two campaigns; returns the exit status. Raises InputError if they are not two, or cannot be compared."""
    if others := [str(path) for path in arguments.runs if not is_campaign(path)]:
        raise InputError(f"{', '.join(others)}: no folder of a campaign, expected two of them, or runs alone")
    if len(arguments.runs) > 2:
        raise InputError(f"{len(arguments.runs)} campaigns, expected two")
    comparison = compare_campaigns(*(read_campaign(path) for path in arguments.runs))
    if arguments.json:
        print(json.dumps(comparison.to_json(), indent=2))
    else:
        print_campaigns(comparison, console_of(100), everything=arguments.all)
    return EXIT_FAILED if comparison.those("newly_failing") else 0


def _searches(arguments: argparse.Namespace) -> int:
    """Compares the margins of two searches; returns the exit status.

    Raises:
        InputError: they are not two, or cannot be compared.
    """
    if len(arguments.runs) > 2:
        raise InputError(f"{len(arguments.runs)} folders, expected two searches")
    change = compare_margins(*(Margins.read(path) for path in arguments.runs))
    if arguments.json:
        print(json.dumps(asdict(change) | {"mean": change.mean, "worse": change.worse}, indent=2))
    else:
        margins = zip(change.names, change.before, change.after, strict=True)
        rows = ((name, f"{before:.2f}", f"{after:.2f}", f"{after - before:+.2f}") for name, before, after in margins)
        console_of().print(figures_table(("margin", "before", "after", "change"), rows))
        bounds = "" if change.interval is None else ", 95 % interval {:+.2f} to {:+.2f}".format(*change.interval)
        print(
            f"mean change {change.mean:+.2f}{bounds}; margins are upper bounds, and at most what the search looked at"
        )
        for name in change.broken:
            print(f"{name} fails as recorded, and did not before")
    return EXIT_FAILED if change.worse else 0
