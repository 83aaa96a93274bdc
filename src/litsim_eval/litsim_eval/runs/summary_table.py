"""The table of a campaign on a terminal of any width: a line per measure, a column per variant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group, RenderableType
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from litsim_eval.analysis.displacement import HORIZONS_S
from litsim_eval.analysis.metric import ADDED, title_of
from litsim_eval.campaign.variant_summary import Bounds

OF_EGO = {
    "runs": "runs",
    "passed": "passed",
    "failed": "not_passed",
    "errors": "errors",
    "contacts of the ego": "ego_contacts",
    "at the ego's fault": "ego_at_fault",
    "red lights passed": "red_ego",
    "standoffs": "standoffs",
    "shortest TTC s": "min_ttc_s",
    "shortest headway s": "min_headway_s",
    "steps in comfort %": "ego_comfort",
    "progress %, of its log's": "ego_progress",
}
"""Measures of the ego, which are shown first."""

OF_SIMULATION = {
    "agents": "agents",
    "colliding agents": "colliding_agents",
    "colliding runs": "colliding_runs",
    "contacts, background's fault": "background_faults",
    "ego's fault, other could avoid": "ego_faults_avoidable",
    "ego's fault, other could not": "ego_faults_unavoidable",
    "collision %, all": "rate_all",
    "collision %, controlled": "rate_controlled",
    "no new contacts %": "reactive",
    "takeovers": "takeovers",
    "takeovers per run": "takeovers_per_run",
    "handed back to their logs": "releases",
    "handed back, %": "released_share",
    "held to the end of the run": "releases_missing",
    "time under control s": "held_s",
    "steps cut short in detection": "bound_hits",
    "false alarms": "false_alarms",
    "taken over near ego %": "relevant_ratio",
    "hard brakes under control": "hard_brakes",
    "of the log meanwhile": "hard_brakes_log",
    "guarded %, of policy C's steps": "guarded",
    "off road %, controlled": "off_road",
    "progress of all agents m": "progress_m",
    "largest jump m": "max_position_jump_m",
    "largest distance at return m": "max_residual_m",
}
"""Measures of the simulation, which are shown on request."""
OF_ALL_RUNS = ("runs", "passed", "not_passed", "errors", "reactive")
"""Measures that also count runs without metrics; `reactive` is over runs of which it is known."""

OF_CONTROL = (
    "rate_controlled",
    "takeovers",
    "takeovers_per_run",
    "releases",
    "released_share",
    "releases_missing",
    "held_s",
    "bound_hits",
    "false_alarms",
    "relevant_ratio",
    "hard_brakes",
    "hard_brakes_log",
    "guarded",
    "off_road",
    "max_position_jump_m",
    "max_residual_m",
    "ade_controlled_m",
)
"""Measures of agents under control, which are meaningless under replay."""

MARK = "*"
PERCENT = (
    *("rate_all", "rate_controlled", "reactive", "released_share", "relevant_ratio", "guarded", "off_road"),
    *("ego_comfort", "ego_progress"),
)
DISPLACEMENTS = (("ade_controlled_m", "controlled"), ("ade_all_m", "all"))
BOUNDS = "bounds"  # key of a variant's bounds, beside its measures


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
        summary: by name of the variant, the result of :func:`litsim_eval.analysis.summary.summarise`, and verdicts.
        console: to print to.
        replayed: whether the background is replayed in all variants; measures of agents under control are left out.
        everything: whether measures of the simulation are shown, not only those of the ego.
        bounds: of the figures, by variant, printed behind them.
    """
    variants = list(summary)
    left_out = set(OF_CONTROL) if replayed else set[str]()
    left_out |= set() if everything else {*OF_SIMULATION.values(), "ade_controlled_m", "ade_all_m"}
    summary = {
        variant: {key: v for key, v in each.items() if key not in left_out} | {BOUNDS: (bounds or {}).get(variant, {})}
        for variant, each in summary.items()
    }
    named = _table({variant: variant for variant in variants}, summary)
    if _fits(named, console):
        parts: list[RenderableType] = [named]
    else:
        numbers = {variant: str(number) for number, variant in enumerate(variants, 1)}
        parts = [
            *_numbered(numbers, summary, console),
            *(Text(f"{numbers[variant]:>3}  {variant}") for variant in variants),
        ]
    lacking = {variant: f"{each['measured']} of {each['runs']}" for variant, each in summary.items() if each["failed"]}
    if lacking:
        parts.append(Text(f"{MARK} over the runs that were measured: " + "; ".join(map(": ".join, lacking.items()))))
    console.print(Group(Text(title), *parts))


def _numbered(numbers: Mapping[str, str], summary: Mapping[str, Mapping[str, Any]], console: Console) -> list[Table]:
    """Returns tables with as many variants as fit, but at least one each."""
    count = len(numbers)
    while count > 1 and not all(_fits(table, console) for table in _spread(numbers, summary, count)):
        count -= 1
    return _spread(numbers, summary, count)


def _spread(numbers: Mapping[str, str], summary: Mapping[str, Mapping[str, Any]], most: int) -> list[Table]:
    """Returns as few tables as possible with at most `most` variants, evenly distributed."""
    variants, tables = list(numbers), -(-len(numbers) // most)
    parts = [variants[len(variants) * i // tables : len(variants) * (i + 1) // tables] for i in range(tables)]
    return [_table({variant: numbers[variant] for variant in part}, summary) for part in parts]


def _fits(table: Table, console: Console) -> bool:
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum <= console.width


def _table(headings: Mapping[str, str], summary: Mapping[str, Mapping[str, Any]]) -> Table:
    """Returns the table of some variants; `headings` are the names of the columns by variant."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    for heading in headings.values():
        table.add_column(heading, justify="right", no_wrap=True)
    columns = [summary[variant] for variant in headings]
    for name, key in (OF_EGO | OF_SIMULATION).items():
        if all(key in variant for variant in columns) and any(variant[key] is not None for variant in columns):
            table.add_row(
                name,
                *(_cell(key, variant[key]) + _mark(key, variant) + _between(key, key, variant) for variant in columns),
            )
    for horizon in map(str, HORIZONS_S):
        if any(variant.get("ade_all_m", {}).get(horizon) is not None for variant in summary.values()):
            for key, whose in ((key, whose) for key, whose in DISPLACEMENTS if key in columns[0]):
                cells = (
                    f"{_cell(key, variant[key][horizon])}{_mark(key, variant)}"
                    f"{_between(key, f'{key}.{horizon}', variant)}{_reached(key, horizon, variant)}"
                    for variant in columns
                )
                table.add_row(f"ADE@{horizon} s m, {whose}", *cells)
    for name in columns[0].get(ADDED, {}):
        table.add_row(
            title_of(name), *(_cell(name, variant[ADDED][name]) + _mark(name, variant) for variant in columns)
        )
    return table


def _mark(key: str, variant: Mapping[str, Any]) -> str:
    """Returns the mark of a figure over fewer than all runs: any but OF_ALL_RUNS in a variant with failed runs."""
    return MARK if variant["failed"] and key not in OF_ALL_RUNS else ""


def _reached(key: str, horizon: str, variant: Mapping[str, Any]) -> str:
    """Returns the number of runs that last to `horizon`, as a suffix of their ADE; empty if all of them do."""
    runs, measured = variant["ade_runs"][horizon], variant["measured"]
    return f" ({runs} of {measured})" if runs < measured and variant[key][horizon] is not None else ""


def _between(key: str, name: str, variant: Mapping[str, Any]) -> str:
    """Returns the bounds `name` of the measure `key`, as a suffix of its figure; empty if there are none."""
    if name not in variant[BOUNDS]:
        return ""
    low, high = (round(bound) if isinstance(variant[key], int) else bound for bound in variant[BOUNDS][name])
    return f" [{_cell(key, low)}, {_cell(key, high)}]"


def _cell(key: str, value: float | None) -> str:
    if value is None:
        return "-"
    if key in PERCENT:
        return f"{100.0 * value:.2f}"
    return str(value) if isinstance(value, int) else f"{value:.3g}"
