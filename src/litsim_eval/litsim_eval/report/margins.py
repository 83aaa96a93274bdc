"""The page of a search: the margin of every scenario, the nearest failures, and a map of what was tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from litsim_eval.report.pages import render_page
from litsim_sim.io.files import write_text

WIDTH, LEFT, ROW = 900.0, 110.0, 34.0
"""Width of a map, room for the names at its left, and height of a row, in pixels."""
ORDER = ("passed", "error", "forced", "failed")
"""Outcomes in the order in which they are drawn, failures last so that they are on top."""
FEW = 30  # runs up to which the rule of three tells nothing
LANES = 5  # heights within a row, so that dots at the same distance are seen


def write_margins_page(margins: Mapping[str, Any], tried: Sequence[Sequence[Mapping[str, Any]]], path: Path) -> None:
    """Writes the page.

    Args:
        margins: the content of `margins.json`.
        tried: for each scenario, its runs: rows of `tried.parquet`.
        path: of the page.

    Raises:
        Unwritable: `path` cannot be written.
    """
    bound = float(margins["bound"])
    scenarios = [
        scenario
        | {"text": _margin(scenario, bound), "share": 100.0 * min(1.0, (scenario["margin"] or 0.0) / bound)}
        | {"tried": tries_text(scenario["tries"]), "rate_text": _rate(scenario)}
        | {"map": _map(rows, bound, scenario["margin"])}
        for scenario, rows in zip(margins["scenarios"], tried, strict=True)
    ]
    page = render_page(
        "margins.html.j2",
        title=f"Margins of {margins['ego']}",
        margins=margins,
        scenarios=scenarios,
        runs=sum(scenario["runs"] for scenario in scenarios),
        failing=sum(scenario["margin"] is not None for scenario in scenarios),
        width=WIDTH,
        row=ROW,
        left=LEFT,
    )
    write_text(path, page)


def _margin(scenario: Mapping[str, Any], bound: float) -> str:
    """Returns the margin of a scenario as text."""
    margin = scenario["margin"]
    if scenario["recorded"] != "passed":
        return f"{scenario['recorded']} as recorded"
    return f"none found up to {bound:g}" if margin is None else f"{margin:.2f}"


def tries_text(tries: Mapping[str, int]) -> str:
    """Returns how many runs differed from that without changes, by kind of act."""
    names = {act: "without an act" if act == "nothing" else act.replace("_", " ") for act in tries}
    acts = ", ".join(f"{count} {names[act]}" for act, count in tries.items())
    return f"{sum(tries.values())} tries" + (f": {acts}" if acts else "")


def _rate(scenario: Mapping[str, Any]) -> str:
    """Returns the rate of failures under the declared distribution as text."""
    if scenario["rate"] is None:
        return "-"
    failed, drawn, (low, high) = scenario["drawn_failed"], scenario["drawn"], scenario["rate"]
    rule = "" if failed or drawn <= FEW else f"; rule of three: below {300.0 / drawn:.1f} %"
    return f"{failed} of {drawn}: {100.0 * low:.1f} to {100.0 * high:.1f} %{rule}"


def _map(rows: Sequence[Mapping[str, Any]], bound: float, margin: float | None) -> dict[str, Any]:
    """Returns a row for each kind of act with a dot for each run, placed by its distance."""
    acts = sorted({row["act"] for row in rows})
    scale = (WIDTH - LEFT - ROW) / bound

    def place(distance: float) -> float:
        return round(LEFT + scale * min(distance, bound), 1)

    dots = [
        {
            "x": place(row["distance"]),
            "y": round(ROW * (acts.index(row["act"]) + (row["number"] % LANES + 1) / (LANES + 1)), 1),
            "outcome": row["outcome"],
            "about": f"{row['number']}, {row['how']}: distance {row['distance']:.2f}, {row['outcome']} {row['reason']}",
        }
        for row in sorted(rows, key=lambda row: ORDER.index(row["outcome"]))
    ]
    ticks = [(place(k), f"{k}" if k < bound else f"{bound:g} or more") for k in range(int(bound) + 1)]
    return {"acts": acts, "dots": dots, "ticks": ticks, "margin": None if margin is None else place(margin)}
