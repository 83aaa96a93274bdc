"""Comparison of two campaigns, on the terminal."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from litsim_eval.campaign.bootstrap import LEVEL, RESAMPLES
from litsim_eval.campaign.comparison import NOT_RUN, PASSED, CampaignComparison, Change, Pair, report_of
from litsim_eval.campaign.results import Campaign, RunResult

WIDTH = 100  # characters per line if the output is not a terminal
CASES_MAX = 20  # most cases of a list, unless everything is requested
DIGITS = 3
SMALL = 1e-3  # numbers below have two digits, to limit the width of the table
MARK = "*"
FEW = 20  # vehicles below which the bootstrap's bounds hold in less than nine of ten cases


def print_campaigns(
    comparison: CampaignComparison, *, everything: bool = False, console: Console | None = None
) -> None:
    """Print the changed verdicts, with both reports of each run, and the measures that have changed.

    Args:
        comparison: the comparison of two campaigns.
        everything: whether to print every measure that differs, not only those that have clearly changed and those of
            criteria; and every case.
        console: output.
    """
    console = console or Console(width=None if sys.stdout.isatty() else WIDTH)
    _print_heading(console, comparison)
    limit = None if everything else CASES_MAX
    for title, pairs, style in (
        ("newly failing", comparison.newly_failing, "bold red"),
        ("newly passing", comparison.newly_passing, "bold green"),
    ):
        _say(console, f"{len(pairs)} of {len(comparison.pairs)} {title}", style if pairs else None)
        for pair in pairs[:limit]:
            _print_pair(console, comparison, pair)
        if len(pairs[:limit]) < len(pairs):
            _say(console, f"  and {len(pairs) - len(pairs[:limit])} more (--all)")
    if comparison.still_failing:
        _say(console, f"{len(comparison.still_failing)} pass in neither")
    if worse := comparison.worse:
        _say(console, f"{len(worse)} of these fail by more than before", "bold red")
        for pair in worse[:limit]:
            _print_worse(console, comparison, pair)
        if len(worse[:limit]) < len(worse):
            _say(console, f"  and {len(worse) - len(worse[:limit])} more (--all)")
    for campaign, cases in ((comparison.before, comparison.only_before), (comparison.after, comparison.only_after)):
        if cases:
            _say(console, f"only in {campaign.folder}: {len(cases)}, such as {cases[0].name}")
    if comparison.renamed:
        _say(console, f"{len(comparison.renamed)} of one name are not the same case: the scenario is another", "yellow")
    _print_changes(console, comparison, everything=everything)


def _print_heading(console: Console, comparison: CampaignComparison) -> None:
    """The folders, and in what the campaigns differ: versions of dependencies, and criteria of runs."""
    _say(console, f"{comparison.before.folder} -> {comparison.after.folder}")
    for name, (before, after) in comparison.other_versions.items():
        _say(console, f"  {name}: {before} -> {after}", "dim")
    if others := comparison.other_criteria:
        _say(console, f"  judged by other criteria, so that equal runs may differ: {', '.join(others)}", "yellow")


def _print_pair(console: Console, comparison: CampaignComparison, pair: Pair) -> None:
    _say(console, f"  {pair.case.name}")
    both = ((comparison.before, pair.before), (comparison.after, pair.after))
    for said, (campaign, result) in zip(("was", "is"), both, strict=True):
        _say(console, f"    {said} {result.verdict.value if result else NOT_RUN}")
        for line in _details(campaign, result):
            _say(console, f"      {line}")


def _print_worse(console: Console, comparison: CampaignComparison, pair: Pair) -> None:
    """The criteria that a case that failed before now misses as well, and its report."""
    _say(console, f"  {pair.case.name}")
    missed = [f"{each.name}: {each.reason}" for each in pair.newly_missed]
    path = report_of(comparison.after, pair.after)
    for line in (*(missed or [f"is error: {pair.after.reason}" if pair.after else ""]), *([str(path)] if path else [])):
        _say(console, f"    {line}")


def _details(campaign: Campaign, result: RunResult | None) -> list[str]:
    """Why a run did not pass, and its report."""
    if result is None:
        return []
    failed = [f"{each.name}: {each.reason}" for each in result.criteria if not each.passed]
    path = report_of(campaign, result)
    return [*(failed or filter(None, [result.reason])), *([str(path)] if path else [])]


def _print_changes(console: Console, comparison: CampaignComparison, *, everything: bool) -> None:
    judged = {
        criterion.field for campaign in (comparison.before, comparison.after) for criterion in campaign.criteria.runs
    }
    differing = [change for change in comparison.changes if change.differs or change.name == PASSED]
    shown = [change for change in differing if everything or change.clear or change.name in judged | {PASSED}]
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    table.add_column("mean over runs of both", overflow="fold")
    for name in ("runs", "before", "after", "change", f"{LEVEL:.0%} interval"):
        table.add_column(name, justify="right", no_wrap=True)
    for change in shown:
        table.add_row(*_cells(change), style="bold" if change.clear else None)
    console.print(table)
    how = f"paired bootstrap over {comparison.vehicles} vehicles, {RESAMPLES} resamples"
    _say(console, f"{MARK} the interval ({how}) leaves out 0", "dim")
    if comparison.vehicles < FEW:
        _say(console, f"  of fewer than {FEW} vehicles it is too narrow: see docs/campaigns.md", "dim")
    if len(shown) < len(differing):
        _say(console, f"{len(differing) - len(shown)} more measures differ (--all)", "dim")


def _cells(change: Change) -> tuple[str, ...]:
    interval = "-" if change.low is None or change.high is None else f"{_text(change.low)} .. {_text(change.high)}"
    return (
        f"{MARK if change.clear else ' '} {change.name}",
        str(change.pairs),
        _text(change.before),
        _text(change.after),
        f"{'+' if change.change > 0.0 else ''}{_text(change.change)}",
        interval,
    )


def _text(value: float) -> str:
    return f"{value:.{DIGITS if value == 0.0 or abs(value) >= SMALL else 2}g}"


def _say(console: Console, text: str, style: str | None = None) -> None:
    """Print a line without wrapping: paths stay in one piece, to be copied or clicked on."""
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
