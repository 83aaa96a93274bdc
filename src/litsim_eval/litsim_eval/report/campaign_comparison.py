"""Comparison of two campaigns, on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

from rich.console import Console
from rich.table import Table

from litsim_eval.campaign.bootstrap import LEVEL, RESAMPLES
from litsim_eval.campaign.comparison import NOT_RUN, PASSED, CampaignComparison, Change, Pair, report_of
from litsim_eval.campaign.results import Campaign

CASES_MAX = 20  # most cases of a list, unless everything is requested
DIGITS = 3
SMALL = 1e-3  # numbers below have two digits, to limit the width of the table
MARK = "*"
FEW = 20  # vehicles below which the bootstrap's bounds hold in less than nine of ten cases


def print_campaigns(comparison: CampaignComparison, console: Console, *, everything: bool) -> None:
    """Prints in what two campaigns differ: versions, criteria, verdicts with both reports of each run, and measures.

    Of measures and cases these are, unless `everything` is asked for, those that have clearly changed and those of
    criteria, and the first CASES_MAX.
    """
    limit = None if everything else CASES_MAX
    _print(console, f"{comparison.before.folder} -> {comparison.after.folder}")
    for name, (before, after) in comparison.other_versions.items():
        _print(console, f"  {name}: {before} -> {after}", "dim")
    if others := comparison.other_criteria:
        _print(console, f"  judged by other criteria, so that equal runs may differ: {', '.join(others)}", "yellow")
    for verdict, style in (("newly_failing", "bold red"), ("newly_passing", "bold green")):
        pairs = comparison.those(verdict)
        title = f"{len(pairs)} of {len(comparison.pairs)} {verdict.replace('_', ' ')}"
        _print_cases(console, title, style if pairs else None, [_both(comparison, pair) for pair in pairs], limit)
    if failing := comparison.those("still_failing"):
        _print(console, f"{len(failing)} pass in neither")
    if worse := comparison.those("worse"):
        title = f"{len(worse)} of these fail by more than before"
        _print_cases(console, title, "bold red", [_worse(comparison.after, pair) for pair in worse], limit)
    for campaign, cases in ((comparison.before, comparison.only_before), (comparison.after, comparison.only_after)):
        if cases:
            _print(console, f"only in {campaign.folder}: {len(cases)}, such as {cases[0].name}")
    if comparison.renamed:
        _print(
            console, f"{len(comparison.renamed)} of one name are not the same case: the scenario is another", "yellow"
        )
    _print_changes(console, comparison, everything=everything)


def _print_cases(
    console: Console, title: str, style: str | None, cases: Sequence[Sequence[str]], limit: int | None
) -> None:
    """Prints a title and the lines of up to `limit` cases."""
    _print(console, title, style)
    for line in chain.from_iterable(cases[:limit]):
        _print(console, f"  {line}")
    if (left := len(cases) - len(cases[:limit])) > 0:
        _print(console, f"  and {left} more (--all)")


def _both(comparison: CampaignComparison, pair: Pair) -> list[str]:
    """Returns the name of a case, and both verdicts with why it did not pass and the report."""
    lines = [pair.case.name]
    both = ((comparison.before, pair.before), (comparison.after, pair.after))
    for verb, (campaign, result) in zip(("was", "is"), both, strict=True):
        lines.append(f"  {verb} {result.verdict.value if result else NOT_RUN}")
        if result is not None:
            failed = [criterion.reason for criterion in result.criteria if not criterion.passed]
            lines += [f"    {line}" for line in (*(failed or [result.reason]), report_of(campaign, result)) if line]
    return lines


def _worse(after: Campaign, pair: Pair) -> list[str]:
    """Returns the name of a case that failed before, the criteria that it now misses as well, and its report."""
    missed = [criterion.reason for criterion in pair.newly_missed]
    lines = missed or [f"is error: {pair.after.reason}" if pair.after else ""]
    return [pair.case.name, *(f"  {line}" for line in (*lines, report_of(after, pair.after)) if line is not None)]


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
    _print(console, f"{MARK} the interval ({how}) leaves out 0", "dim")
    if comparison.vehicles < FEW:
        _print(console, f"  of fewer than {FEW} vehicles it is too narrow: see docs/campaigns.md", "dim")
    if len(shown) < len(differing):
        _print(console, f"{len(differing) - len(shown)} more measures differ (--all)", "dim")


def _cells(change: Change) -> tuple[str, ...]:
    interval = "-" if change.interval is None else " .. ".join(map(_text, change.interval))
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


def _print(console: Console, text: str, style: str | None = None) -> None:
    """Prints a line without wrapping: paths stay in one piece, to be copied or clicked on."""
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
