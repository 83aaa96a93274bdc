"""The page of a search: the margin of every scenario, the nearest failures, and a map of what was tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from litsim_eval.report.pages import render_page
from litsim_sim.io.files import replacing

WIDTH, HEIGHT, MARGIN = 860.0, 200.0, 42.0
"""Size of a map, and the room for names above and below it, in pixels."""
ORDER = ("passed", "error", "forced", "failed")
"""Outcomes in the order in which they are drawn, failures last so that they are on top."""
TOTAL = "distance"


def write_margins_page(margins: Mapping[str, Any], tried: Sequence[Sequence[Mapping[str, Any]]], path: Path) -> None:
    """Writes the page.

    Args:
        margins: the content of `margins.json`.
        tried: for each scenario, its runs: rows of `tried.parquet`, with `distances`: signed, by parameter.
        path: of the page.

    Raises:
        Unwritable: `path` cannot be written.
    """
    bound = float(margins["bound"])
    scenarios = [
        each | _margin(each, bound) | {"rate_text": _rate(each), "map": _map(rows, bound)}
        for each, rows in zip(margins["scenarios"], tried, strict=True)
    ]
    page = render_page(
        "margins.html.j2",
        title=f"Margins of {margins['ego']}",
        margins=margins,
        bound=bound,
        scenarios=scenarios,
        runs=sum(each["runs"] for each in scenarios),
        width=WIDTH,
        height=HEIGHT + 2 * MARGIN,
    )
    with replacing(path) as new:
        new.write_text(page, encoding="utf-8")


def _margin(scenario: Mapping[str, Any], bound: float) -> dict[str, Any]:
    """Returns the margin of a scenario as `text`, and its `share` of the bound in percent, the length of its bar."""
    margin = scenario["margin"]
    if margin is None:
        return {"text": f"none found up to {bound:g}", "share": 100.0}
    text = "fails as recorded" if scenario["recorded"] else f"{margin:.2f}"
    return {"text": text, "share": round(min(100.0, 100.0 * margin / bound), 1)}


def _rate(scenario: Mapping[str, Any]) -> str:
    """Returns the rate of failures under the declared distribution as text."""
    if scenario["rate"] is None:
        return "-"
    failed, drawn, (low, high) = scenario["drawn_failed"], scenario["drawn"], scenario["rate"]
    rule = "" if failed else f"; rule of three: below {100.0 * min(1.0, 3.0 / drawn):.1f} %"
    return f"{failed} of {drawn}: {100.0 * low:.1f} to {100.0 * high:.1f} %{rule}"


def _map(rows: Sequence[Mapping[str, Any]], bound: float) -> dict[str, Any]:
    """Returns parallel coordinates: an axis for each parameter and the whole distance, a line for each run."""
    names = [*sorted({name for row in rows for name in row["distances"]}), TOTAL]
    signed = {name for name in names if any(row["distances"].get(name, 0.0) < 0.0 for row in rows)}
    place = {name: 50.0 + k * (WIDTH - 100.0) / max(1, len(names) - 1) for k, name in enumerate(names)}

    def height(name: str, value: float) -> float:
        share = (value / bound + 1.0) / 2.0 if name in signed else value / bound
        return round(MARGIN + HEIGHT * (1.0 - min(1.0, max(0.0, share))), 1)

    lines = []
    for row in sorted(rows, key=lambda row: ORDER.index(row["outcome"])):
        values = row["distances"] | {TOTAL: row["distance"]}  # what is not changed is at 0
        points = " ".join(f"{place[name]:.1f},{height(name, values.get(name, 0.0))}" for name in names)
        about = "{number}, {how}: {act}, distance {distance:.2f}, {outcome} {reason}".format(**row)
        lines.append({"points": points, "outcome": row["outcome"], "about": about})
    ends = {True: (f"+{bound:g}", f"−{bound:g}"), False: (f"{bound:g}", "0")}  # upper and lower, by whether signed
    axes = [
        {"name": name, "x": round(place[name], 1), "zero": height(name, 0.0), "ends": ends[name in signed]}
        for name in names
    ]
    return {"axes": axes, "lines": lines, "top": MARGIN, "bottom": MARGIN + HEIGHT}
