"""A whole experiment as one HTML file: the policies side by side, and every run."""

from __future__ import annotations

import json
import os.path
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from litsim_sim.core.errors import InputError
from litsim_sim.report.markup import NOTHING, badge, number, page, percent
from litsim_sim.report.run_report import REPORT_FILE, save

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
    rows = [*content["summary"].values(), *content["runs"].values()] if good else []
    metrics = [m for runs in content["runs"].values() for m in runs.values()] if good else []
    if not good or not rows or not all(isinstance(each, dict) for each in (*rows, *metrics)):
        raise InputError(f"{source}: expected the fields summary and runs, as `litsim_policy evaluate` writes them")
    return content


def _render(content: dict[str, Any], source: Path, beside: Path) -> str:
    summary, runs = content["summary"], content["runs"]
    every = [metrics for by_ego in runs.values() for metrics in by_ego.values()]
    scenarios = sorted({str(m.get("scenario", NOTHING)) for m in every})
    egos = sorted({str(m.get("ego", NOTHING)) for m in every})
    invalid = sum(not m.get("valid", True) for m in every)
    return page(
        "experiment.html",
        ("tables.js",),
        title=escape(f"{', '.join(scenarios)}: {', '.join(summary)}"),
        heading=escape(", ".join(scenarios) or source.parent.name),
        subtitle=escape(f"ego by {', '.join(egos)} · {len(every)} runs · policies {', '.join(summary)}"),
        badges=badge(not invalid, "every run valid", f"{invalid} runs not valid"),
        summary=_summary(summary),
        bars="".join(_bars(column, summary) for column in BARS),
        displacement=_displacement(summary),
        runs=_runs(runs, source.parent, beside),
        footnote=escape(
            f"Everything on this page comes from {source.name}; a dash stands where there is nothing to measure."
        ),
    )


def _summary(summary: dict[str, dict[str, Any]]) -> str:
    return _side_by_side(summary, SUMMARY)


def _displacement(summary: dict[str, dict[str, Any]]) -> str:
    """Average displacement from the log by horizon, controlled agents and all."""
    horizons = list(next(iter(summary.values()), {}).get("ade_all_m") or {})
    kinds = (("controlled", "ade_controlled_m"), ("all", "ade_all_m"))
    columns = [
        Column(f"{name}, {horizon} s [m]", lambda row, f=field, h=horizon: row[f][h])  # type: ignore[misc]
        for name, field in kinds
        for horizon in horizons
    ]
    return _side_by_side(summary, columns)


def _side_by_side(summary: dict[str, dict[str, Any]], columns: Iterable[Column]) -> str:
    """A row a measure, a column a policy; the best of several is marked where one end is the better one."""
    head = "".join(f'<th scope="col" class="number">{escape(policy)}</th>' for policy in summary)
    body = ""
    for column in columns:
        values = [column.of(row) for row in summary.values()]
        known = [value for value in values if value is not None]
        best = column.better(known) if column.better and known and min(known) < max(known) else None
        marks = [" best" if best is not None and value == best else "" for value in values]
        texts = [escape(column.text(value)) for value in values]
        cells = (f'<td class="number{mark}">{text}</td>' for mark, text in zip(marks, texts, strict=True))
        body += f'<tr><th scope="row">{escape(column.name)}</th>{"".join(cells)}</tr>' if known else ""
    return f'<div class="scroll"><table><thead><tr><td></td>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _bars(column: Column, summary: dict[str, dict[str, Any]]) -> str:
    values = {policy: column.of(row) for policy, row in summary.items()}
    highest = max((value for value in values.values() if value), default=1.0)
    rows = (
        f'<div class="bar"><span>{escape(policy)}</span>'
        f'<span><i style="width:{100.0 * (value or 0.0) / highest:.1f}%"></i></span>'
        f"<span>{escape(column.text(value))}</span></div>"
        for policy, value in values.items()
    )
    return f"<figure><figcaption>{escape(column.name)}</figcaption>{''.join(rows)}</figure>"


def _runs(runs: dict[str, dict[str, Any]], folder: Path, beside: Path) -> str:
    """Every run in a table that can be sorted; one that has a report is linked."""
    names = ("policy", "run", "valid", *(column.name for column in RUN), "report")
    head = "".join(f'<th scope="col"><button type="button">{escape(name)}</button></th>' for name in names)
    body = ""
    for policy, by_name in runs.items():
        for name, metrics in by_name.items():
            valid = bool(metrics.get("valid", True))
            cells = [escape(policy), escape(name), badge(valid, "yes", "no")]
            cells += [escape(column.text(column.of(metrics))) for column in RUN]
            recording = metrics.get("recording")  # of runs over DDS
            cells.append(_link(folder / recording / REPORT_FILE, beside) if recording else NOTHING)
            body += f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
    return (
        f'<div class="scroll"><table class="sortable"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _link(report: Path, beside: Path) -> str:
    if not report.is_file():
        return NOTHING
    relative = Path(os.path.relpath(report.resolve(), beside.resolve())).as_posix()
    return f'<a href="{escape(quote(relative), quote=True)}">open</a>'
