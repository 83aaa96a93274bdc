"""A campaign as one HTML file: verdicts, variants side by side, distributions of measures, and every run."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from litsim_eval.analysis.displacement import HORIZONS_S
from litsim_eval.analysis.metric import ADDED, Better, added_metrics
from litsim_eval.analysis.metrics_tree import leaves
from litsim_eval.campaign.criteria import CriterionResult, Verdict
from litsim_eval.campaign.results import EXPERIMENT_REPORT_FILE, RUNS_FOLDER, Campaign, RunResult
from litsim_eval.campaign.variant_summary import variant_summary
from litsim_eval.report.campaign_content import criteria_of, pack_campaign
from litsim_eval.report.pages import render_page
from litsim_eval.report.run_report import save
from litsim_eval.report.thumbnails import read_thumbnail, write_thumbnail
from litsim_eval.report.wording import leaf, number, percent
from litsim_sim.core.errors import InputError
from litsim_sim.record.run import read_run

TAGS_MAX = 30  # most tags in the table by tag, the worst ones
NOT_PASSED = "not passed"  # a choice of the filter by verdict, as in assets/campaign_runs.js
NAMES_MAX = 4  # most scenarios, egos or policies that a heading names; of more it gives the number


@dataclass(frozen=True)
class Column:
    """One measure: its name, its path in the summary of a variant, its text, and which of several values is better.

    `of_all`: runs without measures count in it.
    """

    name: str
    path: str
    text: Callable[[Any], str] = number
    better: Callable[[Iterable[float]], float] | None = None
    of_all: bool = False


OF_EGO = (
    Column("runs", "runs", of_all=True),
    Column("passed", "passed_share", percent, max, of_all=True),
    Column("not judged", "errors", better=min, of_all=True),
    Column("contacts of the ego", "ego_contacts", better=min),
    Column("at the ego's fault", "ego_at_fault", lambda v: number(v, 0), better=min),
    Column("red lights passed", "red_ego", lambda v: number(v, 0), better=min),
    Column("standoffs", "standoffs", lambda v: number(v, 0), better=min),
    Column("shortest time to collision [s]", "min_ttc_s", better=max),
    Column("shortest headway [s]", "min_headway_s", better=max),
    Column("steps in comfort", "ego_comfort", percent, max),
    Column("progress, of its log's", "ego_progress", percent),
)
"""Measures of the ego."""

OF_SIMULATION = (
    Column("without measures", "failed", better=min, of_all=True),
    Column("not valid", "invalid", better=min, of_all=True),
    Column("agents", "agents"),
    Column("agents that collide", "colliding_agents", better=min),
    Column("runs with collisions", "colliding_runs", better=min),
    Column("pairs not in the log", "excess_pairs", better=min),
    Column("at a background agent's fault", "background_faults", better=min),
    Column("at the ego's fault, the other could avoid it", "ego_faults_avoidable", better=min),
    Column("at the ego's fault, the other could not", "ego_faults_unavoidable"),
    Column("collision rate, all", "rate_all", percent, min),
    Column("collision rate, controlled", "rate_controlled", percent, min),
    Column("runs without new contacts", "reactive", percent, max, of_all=True),
    Column("takeovers", "takeovers"),
    Column("false alarms", "false_alarms", better=min),
    Column("agents taken over near the ego", "relevant_ratio", percent),
    Column("progress of all agents [m]", "progress_m", lambda v: number(v, 1)),
    Column("largest jump [m]", "max_position_jump_m", lambda v: number(v, 3), min),
    Column("largest distance at the return [m]", "max_residual_m", lambda v: number(v, 3), min),
    Column("× real time", "realtime_factor", lambda v: number(v, 1), max),
)
"""Measures of the simulation; those that are 0 in all variants are left out."""


def write_experiment_report(campaign: Campaign, out: Path | None = None, quiet: bool = True) -> Path:
    """Writes the page of a campaign, finished or not.

    Args:
        campaign: see :func:`litsim_eval.campaign.results.read_campaign`.
        out: the page; default: `experiment.html` in its folder. Reports and logs of runs are linked from there.
        quiet: whether to hide the progress of making missing pictures of runs from their recordings.

    Returns:
        The path of the page.

    Raises:
        InputError: the page cannot be written.
    """
    path = out or campaign.folder / EXPERIMENT_REPORT_FILE
    save(_render(campaign, _pictures(campaign, quiet), path.parent), path)
    return path


def _pictures(campaign: Campaign, quiet: bool) -> dict[str, dict[str, Any]]:
    """Returns pictures of runs by id, made when they ended or else from their recordings, if available."""
    pictures = {}
    lacking = []
    for result in campaign.results:
        picture = read_thumbnail(_folder(campaign, result))
        if picture is not None:
            pictures[result.case.id] = picture
        elif result.recording is not None and result.metrics is not None:
            lacking.append(result)
    for result in tqdm(lacking, unit="picture", disable=quiet or not lacking, dynamic_ncols=True):
        own = _folder(campaign, result)
        try:
            write_thumbnail(read_run(own / str(result.recording)), dict(result.metrics or {}), own)
        except InputError:  # a recording that was lost or moved since: the page lacks its picture
            continue
        picture = read_thumbnail(own)
        if picture is not None:
            pictures[result.case.id] = picture
    return pictures


def _folder(campaign: Campaign, result: RunResult) -> Path:
    return campaign.folder / RUNS_FOLDER / result.case.id


def _render(campaign: Campaign, pictures: dict[str, dict[str, Any]], beside: Path) -> str:
    by_variant = campaign.variants
    summary = {variant: variant_summary(results) for variant, results in by_variant.items()}
    return render_page(
        "experiment.html.j2",
        title=campaign.name,
        heading=campaign.name,
        subtitle=_subtitle(campaign),
        judged=[_suite_criterion(each) for each in campaign.judged],
        passed=campaign.passes,
        missing=len(campaign.missing),
        variants=[_verdicts(name, results) for name, results in by_variant.items()],
        names=list(by_variant),
        criteria=_criteria(campaign, by_variant),
        tags=_tags(by_variant),
        summary=_side_by_side(summary, (*OF_EGO, *_added())),
        simulation=_side_by_side(summary, OF_SIMULATION, with_zeros=False),
        displacement=_side_by_side(summary, _displacement()),
        unmeasured=any(variant["failed"] for variant in summary.values()),
        about=[("begun", campaign.begun_at), *((name, str(version)) for name, version in campaign.versions.items())],
        pictured=bool(pictures),
        footnote=f"Everything on this page comes from the folder {campaign.folder.resolve().name}; a dash stands where "
        "there is nothing to measure.",
        data=pack_campaign(campaign, pictures, beside),
    )


def _subtitle(campaign: Campaign) -> str:
    cases = campaign.cases
    parts = (
        ("scenarios", "scenario", [Path(case.scenario).stem for case in cases]),
        ("egos", "ego by", [case.ego.name for case in cases]),
        ("policies", "background by", [case.policy for case in cases]),
    )
    texts = [f"{len(campaign.results)} of {len(cases)} runs" if campaign.missing else f"{len(cases)} runs"]
    for several, one, names in parts:
        different = list(dict.fromkeys(names))
        texts.append(f"{one} {', '.join(different)}" if len(different) <= NAMES_MAX else f"{len(different)} {several}")
    return " · ".join(texts)


def _verdicts(name: str, results: list[RunResult]) -> dict[str, Any]:
    """Returns how many runs of a variant passed, failed and could not be judged, and the share of all that passed."""
    counts = Counter(each.verdict for each in results)
    parts = [
        {"verdict": verdict.value, "count": counts[verdict], "filter": _filter(variant=name, verdict=verdict.value)}
        for verdict in Verdict
    ]
    share = percent(counts[Verdict.PASSED] / len(results) if results else None)
    return {"name": name, "parts": parts, "share": share, "count": len(results)}


def _suite_criterion(found: CriterionResult) -> dict[str, Any]:
    """Returns one criterion of the whole campaign."""
    return {
        "name": found.name,
        "rule": _rule(found.name, found.field, found.limit),
        "value": leaf(found.value),
        "passed": found.passed,
        "reason": found.reason,
    }


def _rule(name: str, field: str, limit: str) -> str:
    """Returns the limit of a criterion; empty if its name says it already."""
    rule = f"{field} {limit}"
    return "" if rule == name else rule


def _filter(**fields: str) -> str:
    """Returns filters of the table of runs, which a button of the page sets."""
    return json.dumps(fields)


def _criteria(campaign: Campaign, by_variant: dict[str, list[RunResult]]) -> list[dict[str, Any]]:
    """Returns the number of runs of each variant that missed each criterion, of those judged by it."""
    judged: Counter[tuple[Any, ...]] = Counter()
    missed: Counter[tuple[Any, ...]] = Counter()
    for result in campaign.results:
        for each in result.criteria:
            key = (result.case.variant, each.name, each.field, each.limit)
            judged[key] += 1
            missed[key] += not each.passed
    return [
        {
            "name": name,
            "rule": _rule(name, field, limit),
            "any": any(missed[variant, name, field, limit] for variant in by_variant),
            "cells": [
                _cell(
                    missed[variant, name, field, limit],
                    judged[variant, name, field, limit],
                    variant=variant,
                    criterion=name,
                )
                for variant in by_variant
            ],
        }
        for name, field, limit in criteria_of(campaign)
    ]


def _tags(by_variant: dict[str, list[RunResult]]) -> list[dict[str, Any]]:
    """Returns how many runs of each variant have not passed, of those with a tag, by tag; the worst tags first."""
    tagged: Counter[tuple[str, str]] = Counter()
    missed: Counter[tuple[str, str]] = Counter()
    for variant, results in by_variant.items():
        for result in results:
            for tag in result.case.tags:
                tagged[variant, tag] += 1
                missed[variant, tag] += result.verdict != Verdict.PASSED
    shares = {}
    for tag in {tag for _, tag in tagged}:
        shares[tag] = sum(missed[variant, tag] for variant in by_variant) / sum(
            tagged[variant, tag] for variant in by_variant
        )
    return [
        {
            "name": tag,
            "rule": "",
            "any": shares[tag] > 0,
            "cells": [
                _cell(missed[variant, tag], tagged[variant, tag], variant=variant, tag=tag, verdict=NOT_PASSED)
                for variant in by_variant
            ],
        }
        for tag in sorted(shares, key=lambda tag: (-shares[tag], tag))[:TAGS_MAX]
    ]


def _cell(count: int, total: int, **fields: str) -> dict[str, Any]:
    """Returns how many of all, and the filters that show them."""
    return {"count": count, "total": total, "filter": _filter(**fields)}


def _added() -> Iterator[Column]:
    """Yields means of the measures that other packages add."""
    better: dict[Better, Callable[[Iterable[float]], float]] = {Better.LOWER: min, Better.HIGHER: max}
    for name, metric in added_metrics().items():
        title = f"{name} [{metric.unit}]" if metric.unit else name
        yield Column(title, f"{ADDED}.{name}", better=better.get(metric.better))


def _displacement() -> Iterator[Column]:
    """Yields the average displacement from the log by horizon, of controlled agents and of all."""
    for name, field in (("controlled", "ade_controlled_m"), ("all", "ade_all_m")):
        for horizon in HORIZONS_S:
            yield Column(f"{name}, {horizon} s [m]", f"{field}.{horizon}")


def _reached(row: dict[str, Any], path: str) -> str:
    """Returns how many runs lasted up to the horizon of a displacement, as a suffix of it; empty if all of them did."""
    runs = row.get(f"ade_runs.{path.rpartition('.')[2]}", row["measured"])
    return f" ({runs} of {row['measured']})" if runs < row["measured"] else ""


def _side_by_side(
    summary: dict[str, dict[str, Any]], columns: Iterable[Column], *, with_zeros: bool = True
) -> list[dict[str, Any]]:
    """Returns a row for each measure that any variant has, with a cell for each variant; the best of several is marked.

    Values that leave out runs without measures have an asterisk. They are never marked as the best, as those runs might
    have changed them.
    """
    lines = []
    rows = [leaves(variant) for variant in summary.values()]
    for column in columns:
        values = [row[column.path] for row in rows]
        marks = ["*" if row["failed"] and not column.of_all else "" for row in rows]
        whole = [value for value, mark in zip(values, marks, strict=True) if value is not None and not mark]
        best = column.better(whole) if column.better and whole and min(whole) < max(whole) else None
        cells = [
            {
                "text": column.text(value) + ("" if value is None else _reached(row, column.path) + mark),
                "best": best is not None and value == best and not mark,
            }
            for row, value, mark in zip(rows, values, marks, strict=True)
        ]
        if any(value is not None and (value or with_zeros) for value in values):
            lines.append({"name": column.name, "cells": cells})
    return lines
