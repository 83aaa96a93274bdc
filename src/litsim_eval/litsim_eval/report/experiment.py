"""A campaign as one HTML file: verdicts, variants side by side, distributions of measures, and every run."""

from __future__ import annotations

import json
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

from tqdm import tqdm

from litsim_eval.analysis.measure import Table
from litsim_eval.analysis.metrics import leaves
from litsim_eval.analysis.summary import mark_of, reached, rows_of
from litsim_eval.campaign.background import background_sentences
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.results import EXPERIMENT_REPORT_FILE, RUNS_FOLDER, Campaign, RunResult
from litsim_eval.campaign.variant_summary import DrawnCase, drawn_cases, variant_summary
from litsim_eval.report.campaign_content import criteria_of, pack_campaign
from litsim_eval.report.pages import render_page
from litsim_eval.report.thumbnails import read_thumbnail, write_thumbnail
from litsim_eval.report.wording import leaf, number, percent
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text
from litsim_sim.record.run import read_run

TAGS_MAX = 30  # most tags in the table by tag, the worst ones
NOT_PASSED = "not passed"  # a choice of the filter by verdict, as in assets/campaign_runs.js
NAMES_MAX = 4  # most scenarios, egos or policies that a heading names; of more it gives the number


def write_experiment_report(campaign: Campaign, out: Path | None = None, quiet: bool = True) -> Path:
    """Writes the page of a campaign, finished or not, with links to reports and logs of runs; returns its path.

    That is `out`, by default `experiment.html` in the campaign's folder. Missing pictures of runs are made from their
    recordings, with progress unless `quiet`.

    Raises:
        InputError: the page cannot be written.
    """
    path = out or campaign.folder / EXPERIMENT_REPORT_FILE
    write_text(path, _render(campaign, _pictures(campaign, quiet), path.parent))
    return path


def _pictures(campaign: Campaign, quiet: bool) -> dict[str, dict[str, Any]]:
    """Returns pictures of runs by id, made when they ended or else from their recordings, if available."""
    folders = {result.case.id: campaign.folder / RUNS_FOLDER / result.case.id for result in campaign.results}
    recorded = [shown for shown in campaign.results if shown.recording is not None and shown.metrics is not None]
    lacking = [shown for shown in recorded if read_thumbnail(folders[shown.case.id]) is None]
    for result in tqdm(lacking, unit="picture", disable=quiet or not lacking, dynamic_ncols=True):
        own = folders[result.case.id]
        with suppress(InputError):  # a recording that was lost or moved since: the page lacks its picture
            write_thumbnail(read_run(own / str(result.recording)), dict(result.metrics or {}), own)
    pictures = {name: read_thumbnail(folder) for name, folder in folders.items()}
    return {name: picture for name, picture in pictures.items() if picture is not None}


def _render(campaign: Campaign, pictures: dict[str, dict[str, Any]], beside: Path) -> str:
    by_variant = campaign.variants
    summary = {variant: variant_summary(results) for variant, results in by_variant.items()}
    return render_page(
        "experiment.html.j2",
        title=campaign.name,
        heading=campaign.name,
        subtitle=_subtitle(campaign),
        judged=[
            {
                "name": result.name,
                "rule": _rule(result.name, result.field, result.limit),
                "value": leaf(result.value),
                "passed": result.passed,
                "reason": result.reason,
            }
            for result in campaign.judged
        ],
        passed=campaign.passes,
        missing=len(campaign.missing),
        variants=[_verdicts(name, results) for name, results in by_variant.items()],
        drawn=[_drawn(case) for case in drawn_cases(campaign.results)],
        names=list(by_variant),
        criteria=_criteria(campaign, by_variant),
        tags=_tags(by_variant),
        summary=_side_by_side(summary, Table.EGO),
        simulation=_side_by_side(summary, Table.SIMULATION, with_zeros=False),
        traffic=_side_by_side(summary, Table.TRAFFIC),
        displacement=_side_by_side(summary, Table.DISPLACEMENT),
        unmeasured=any(variant["failed"] for variant in summary.values()),
        about=[("begun", campaign.begun_at), *((name, str(version)) for name, version in campaign.versions.items())],
        pictured=bool(pictures),
        background=background_sentences(campaign.cases),
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
    for several, singular, names in parts:
        different = list(dict.fromkeys(names))
        texts.append(
            f"{singular} {', '.join(different)}" if len(different) <= NAMES_MAX else f"{len(different)} {several}"
        )
    return " · ".join(texts)


def _drawn(case: DrawnCase) -> dict[str, str]:
    """Returns with how many draws of the drivers a case fails, and how probable that makes it."""
    low, high = (percent(bound) for bound in case.bounds)
    return {
        "name": case.name,
        "fails": f"{case.failed} of {case.drivers}",
        "probability": f"{percent(case.probability)} [{low}, {high}]",
    }


def _verdicts(name: str, results: list[RunResult]) -> dict[str, Any]:
    """Returns how many runs of a variant passed, failed and could not be judged, and the share of all that passed."""
    counts = Counter(result.verdict for result in results)
    parts = [
        {"verdict": verdict.value, "count": counts[verdict], "filter": _filter(variant=name, verdict=verdict.value)}
        for verdict in Verdict
    ]
    share = percent(counts[Verdict.PASSED] / len(results) if results else None)
    return {"name": name, "parts": parts, "share": share, "count": len(results)}


def _rule(name: str, field: str, limit: str) -> str:
    """Returns the limit of a criterion; empty if its name says it already."""
    rule = f"{field} {limit}"
    return "" if rule == name else rule


def _filter(**fields: str) -> str:
    """Returns filters of the table of runs, which a button of the page sets."""
    return json.dumps(fields)


def _criteria(campaign: Campaign, by_variant: dict[str, list[RunResult]]) -> list[dict[str, Any]]:
    """Returns the number of runs of each variant that missed each criterion, of those judged by it."""
    rows = []
    for name, field, limit in criteria_of(campaign):
        passed = {
            variant: [
                criterion.passed
                for result in results
                for criterion in result.criteria
                if (criterion.name, criterion.field, criterion.limit) == (name, field, limit)
            ]
            for variant, results in by_variant.items()
        }
        rows.append(_row(name, _rule(name, field, limit), passed, criterion=name))
    return rows


def _tags(by_variant: dict[str, list[RunResult]]) -> list[dict[str, Any]]:
    """Returns how many runs of each variant have not passed, of those with a tag, by tag; the worst tags first."""
    passed: dict[str, dict[str, list[bool]]] = {}
    for variant, results in by_variant.items():
        for result in results:
            for tag in result.case.tags:
                of_tag = passed.setdefault(tag, {name: [] for name in by_variant})
                of_tag[variant].append(result.verdict == Verdict.PASSED)
    rows = {tag: _row(tag, "", of_tag, tag=tag, verdict=NOT_PASSED) for tag, of_tag in passed.items()}

    def missed(tag: str) -> float:
        cells = rows[tag]["cells"]
        return float(sum(cell["count"] for cell in cells) / sum(cell["total"] for cell in cells))

    return [rows[tag] for tag in sorted(rows, key=lambda tag: (-missed(tag), tag))[:TAGS_MAX]]


def _row(name: str, rule: str, passed: dict[str, list[bool]], **filters: str) -> dict[str, Any]:
    """Returns how many runs of each variant missed something, whether `passed` by variant, and filters to show them."""
    cells = [
        {"count": passes.count(False), "total": len(passes), "filter": _filter(variant=variant, **filters)}
        for variant, passes in passed.items()
    ]
    return {"name": name, "rule": rule, "any": any(cell["count"] for cell in cells), "cells": cells}


def _side_by_side(summary: dict[str, dict[str, Any]], table: Table, *, with_zeros: bool = True) -> list[dict[str, Any]]:
    """Returns the rows of a table that any variant has, with a cell for each variant; the best of several is marked.

    Values that leave out runs without measures have a mark. They are never marked as the best, as those runs might have
    changed them.
    """
    lines = []
    variants = [leaves(variant) for variant in summary.values()]
    for row in rows_of(table):
        values = [variant[row.name] for variant in variants]
        marks = [mark_of(row, variant) for variant in variants]
        whole = [value for value, mark in zip(values, marks, strict=True) if value is not None and not mark]
        best = row.better.best(whole) if row.better else None
        text = percent if row.share else number
        cells = [
            {
                "text": text(value) + ("" if value is None else reached(row, variant) + mark),
                "best": best is not None and value == best and not mark,
            }
            for variant, value, mark in zip(variants, values, marks, strict=True)
        ]
        if any(value is not None and (value or with_zeros) for value in values):
            lines.append({"name": row.heading, "cells": cells})
    return lines
