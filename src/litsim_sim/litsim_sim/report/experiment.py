"""A whole experiment as one HTML file: the policies side by side, and every run."""

from __future__ import annotations

import json
import os.path
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from litsim_sim.core.errors import InputError
from litsim_sim.report.pages import render_page
from litsim_sim.report.run_report import REPORT_FILE, save
from litsim_sim.report.wording import NOTHING, number, percent

EVALUATION_FILE = "evaluation.json"
EXPERIMENT_REPORT_FILE = "experiment.html"


@dataclass(frozen=True)
class Column:
    """One measure: its name, how to find it in a row, how it reads, and which end of it is the better one."""

    name: str
    find: Callable[[dict[str, Any]], Any]
    text: Callable[[Any], str] = number
    better: Callable[[Iterable[float]], float] | None = None

    def of(self, row: dict[str, Any]) -> float | None:
        """The value in `row`; None where an older or newer evaluation has none."""
        try:
            value = self.find(row)
        except (KeyError, TypeError):
            return None
        return value if isinstance(value, int | float) else None


def _key(name: str) -> Callable[[dict[str, Any]], Any]:
    return lambda row: row[name]


SUMMARY = (
    Column("runs", _key("runs")),
    Column("failed", _key("failed"), better=min),
    Column("not valid", _key("invalid"), better=min),
    Column("agents", _key("agents")),
    Column("agents that collide", _key("colliding_agents"), better=min),
    Column("runs with collisions", _key("colliding_runs"), better=min),
    Column("pairs not in the log", _key("excess_pairs"), better=min),
    Column("contacts of the ego", _key("ego_contacts"), better=min),
    Column("collision rate, all", _key("rate_all"), percent, min),
    Column("collision rate, controlled", _key("rate_controlled"), percent, min),
    Column("reactive runs", _key("reactive"), percent, max),
    Column("takeovers", _key("takeovers")),
    Column("false alarms", _key("false_alarms"), better=min),
    Column("relevant agents", _key("relevant_ratio"), percent),
    Column("progress [m]", _key("progress_m"), lambda v: number(v, 1)),
    Column("largest jump [m]", _key("max_position_jump_m"), lambda v: number(v, 3), min),
    Column("largest residual [m]", _key("max_residual_m"), lambda v: number(v, 3), min),
    Column("× real time", _key("realtime_factor"), lambda v: number(v, 1), max),
)
BARS = (
    Column("Reactive runs", _key("reactive"), percent),
    Column("Collision rate of controlled agents", _key("rate_controlled"), percent),
    Column("Agents that collide", _key("colliding_agents")),
    Column("Takeovers", _key("takeovers")),
)
RUN = (
    Column("pairs not in the log", lambda m: m["collision"]["excess"]),
    Column("contacts of the ego", lambda m: len(m["collision"]["ego_contacts"])),
    Column("takeovers", _key("takeovers")),
    Column("false alarms", _key("false_alarms")),
    Column("ADE@10 s controlled [m]", lambda m: m["ade_controlled_m"]["10"]),
    Column("progress [m]", _key("progress_m"), lambda v: number(v, 1)),
    Column("largest jump [m]", lambda m: m["handback"]["max_position_jump_m"], lambda v: number(v, 3)),
    Column("wall time [s]", lambda m: m["timing"]["wall_s"], lambda v: number(v, 1)),
)


def write_experiment_report(evaluation: Path, out: Path | None = None) -> Path:
    """Write the report of an experiment.

    Args:
        evaluation: `evaluation.json` as `litsim_policy evaluate --out DIR` leaves it, or that DIR.
        out: the page; default: `experiment.html` beside it. Runs that have a report of their own are linked from there.

    Returns:
        where the page was written.

    Raises:
        InputError: no evaluation, or the page cannot be written.
    """
    source = evaluation / EVALUATION_FILE if evaluation.is_dir() else evaluation
    content = _read(source)
    path = out or source.parent / EXPERIMENT_REPORT_FILE
    save(_render(content, source, path.parent), path)
    return path


def _read(source: Path) -> dict[str, Any]:
    try:
        content = json.loads(source.read_text())
    except OSError as error:
        raise InputError(f"{source}: no evaluation to report on: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{source}: not JSON: {error}") from error
    good = isinstance(content, dict) and all(isinstance(content.get(k), dict) for k in ("summary", "runs"))
    if good:
        content.setdefault("failures", {})  # older evaluations ended at the first
    good = good and isinstance(content["failures"], dict)
    rows = [each for name in ("summary", "runs", "failures") for each in content[name].values()] if good else []
    metrics = [m for runs in content["runs"].values() for m in runs.values()] if good else []
    if not good or not rows or not all(isinstance(each, dict) for each in (*rows, *metrics)):
        raise InputError(f"{source}: expected the fields summary and runs, as `litsim_policy evaluate` writes them")
    return content


def _render(content: dict[str, Any], source: Path, beside: Path) -> str:
    summary, runs = content["summary"], content["runs"]
    every = [metrics for by_ego in runs.values() for metrics in by_ego.values()]
    scenarios = sorted({str(m.get("scenario", NOTHING)) for m in every})
    egos = sorted({str(m.get("ego", NOTHING)) for m in every})
    failures = [(row, run, why) for row, mine in content["failures"].items() for run, why in mine.items()]
    bad = {"not valid": sum(not m.get("valid", True) for m in every), "failed": len(failures)}
    return render_page(
        "experiment.html.j2",
        title=f"{', '.join(scenarios)}: {', '.join(summary)}",
        heading=", ".join(scenarios) or source.parent.name,
        subtitle=f"ego by {', '.join(egos)} · {len(every) + len(failures)} runs · policies {', '.join(summary)}",
        problems=", ".join(f"{n} {'run' if n == 1 else 'runs'} {what}" for what, n in bad.items() if n),
        failures=failures,
        policies=list(summary),
        bars=[_chart(column, summary) for column in BARS],
        summary=_side_by_side(summary, SUMMARY),
        displacement=_side_by_side(summary, _displacement(summary)),
        measures=[column.name for column in RUN],
        runs=_runs(runs, source.parent, beside),
        footnote=f"Everything on this page comes from {source.name}; a dash stands where there is nothing to measure.",
    )


def _displacement(summary: dict[str, dict[str, Any]]) -> list[Column]:
    """Average displacement from the log by horizon, of controlled agents and of all."""
    horizons = list(next(iter(summary.values()), {}).get("ade_all_m") or {})
    kinds = (("controlled", "ade_controlled_m"), ("all", "ade_all_m"))
    return [
        Column(f"{name}, {horizon} s [m]", lambda row, f=field, h=horizon: row[f][h])  # type: ignore[misc]
        for name, field in kinds
        for horizon in horizons
    ]


def _side_by_side(summary: dict[str, dict[str, Any]], columns: Iterable[Column]) -> list[dict[str, Any]]:
    """A row for each measure that any policy has, a cell for each policy; the best of several values is marked."""
    rows = []
    for column in columns:
        values = [column.of(row) for row in summary.values()]
        known = [value for value in values if value is not None]
        best = column.better(known) if column.better and known and min(known) < max(known) else None
        cells = [{"text": column.text(value), "best": best is not None and value == best} for value in values]
        if known:
            rows.append({"name": column.name, "cells": cells})
    return rows


def _chart(column: Column, summary: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """A bar for each policy, its length in percent of the highest value."""
    values = {policy: column.of(row) for policy, row in summary.items()}
    highest = max((value for value in values.values() if value), default=1.0)
    bars = [
        {"policy": policy, "percent": 100.0 * (value or 0.0) / highest, "text": column.text(value)}
        for policy, value in values.items()
    ]
    return {"name": column.name, "bars": bars}


def _runs(runs: dict[str, dict[str, Any]], folder: Path, beside: Path) -> list[dict[str, Any]]:
    """Every run: policy, name, whether it is valid, its measures as text, and the address of its report, or None."""
    return [
        {
            "policy": policy,
            "name": name,
            "valid": bool(metrics.get("valid", True)),
            "measures": [column.text(column.of(metrics)) for column in RUN],
            "report": _link(folder, metrics.get("recording"), beside),
        }
        for policy, by_name in runs.items()
        for name, metrics in by_name.items()
    ]


def _link(folder: Path, recording: str | None, beside: Path) -> str | None:
    """Address of a run's report as seen from `beside`; None without one. Only runs over DDS name a `recording`."""
    report = folder / recording / REPORT_FILE if recording else None
    if report is None or not report.is_file():
        return None
    return quote(Path(os.path.relpath(report.resolve(), beside.resolve())).as_posix())
