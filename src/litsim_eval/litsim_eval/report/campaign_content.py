"""Data of each run in the page of a campaign, for its table, its distributions and the panel of one run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from litsim_eval.analysis.measure import Table
from litsim_eval.analysis.metrics import leaves, measures, measures_by_field
from litsim_eval.campaign.results import RUNS_FOLDER, Campaign, RunResult, rerun_command
from litsim_eval.report.packing import Packer
from litsim_eval.report.thumbnails import UNIT_RAD
from litsim_eval.report.wording import leaf
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.files import relative

DIGITS = 5  # significant digits of numbers on the page
SHOWN = 5
FIRST = (Table.EGO, Table.SIMULATION)
"""The table of runs shows, after criteria, the first :data:`SHOWN` measures of these tables that differ."""
LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")
TOO_FINE = ("timing.stage_ms.", "timing.path_ms.", "lockstep.missed_by_topic.", "lockstep.ego_port.")
"""Branches of the measures that are left out, as their fields differ from run to run."""


def pack_campaign(campaign: Campaign, pictures: Mapping[str, Mapping[str, Any]], beside: Path) -> str:
    """Returns the runs of a campaign as a container of :mod:`litsim_eval.report.packing`.

    `pictures` are thumbnails of runs by id; links are relative to `beside`, the folder of the page.
    """
    results = campaign.results
    variants = list(campaign.variants)
    criteria = criteria_of(campaign)
    tags = sorted({tag for result in results for tag in result.case.tags})
    content = {
        "dt": STEP_S,
        "picture_turn": UNIT_RAD,
        "variants": variants,
        "criteria": [{"name": name, "field": field, "limit": limit} for name, field, limit in criteria],
        "tags": tags,
        "fields": fields_of(campaign),
        "runs": [
            {
                **_case(result),
                "rerun": rerun_command(campaign.folder, result.case),
                "variant": variants.index(result.case.variant),
                "tags": [tags.index(tag) for tag in result.case.tags],
                "criteria": [
                    {
                        "criterion": criteria.index((criterion.name, criterion.field, criterion.limit)),
                        "value": criterion.value,
                        "passed": criterion.passed,
                        "reason": criterion.reason,
                    }
                    for criterion in result.criteria
                ],
                **_links(result, campaign.folder, beside),
                **_happenings(result.metrics),
                "picture": pictures.get(result.case.id),
            }
            for result in results
        ],
    }
    return Packer(content).pack()


def criteria_of(campaign: Campaign) -> list[tuple[str, str, str]]:
    """Returns name, field and limit of the criteria of the campaign, and of all others that a result was judged by."""
    own = [(run.title, run.field, run.limit) for run in campaign.criteria.runs]
    judged = [
        (criterion.name, criterion.field, criterion.limit)
        for result in campaign.results
        for criterion in result.criteria
    ]
    return list(dict.fromkeys((*own, *judged)))


def fields_of(campaign: Campaign) -> list[dict[str, Any]]:
    """Returns every measure that is a number or a boolean in any run, with its value in each.

    Returns:
        For each its path, title, digits, definition, the limits that criteria set on it, whether it is shown from the
        start, and its values in the order of the runs, None where a run has none. Those shown come first.
    """
    runs = [_numbers(result) for result in campaign.results]
    measured = dict.fromkeys(path for run in runs for path in run)
    judged = dict.fromkeys(criterion.field for criterion in campaign.criteria.runs)
    in_tables = (shown.name for table in FIRST for shown in measures() if any(row.table == table for row in shown.rows))
    first = dict.fromkeys((*judged, *in_tables))
    main = [path for path in first if len({run.get(path) for run in runs} - {None}) > 1][:SHOWN]
    titled = [path for path, measure in measures_by_field().items() if measure.title and path in measured]
    return [
        {
            "path": path,
            **_named(path),
            "limits": [
                bound
                for criterion in campaign.criteria.runs
                for bound in (criterion.min, criterion.max)
                if criterion.field == path and bound is not None
            ],
            "main": path in main,
            "values": [run.get(path) for run in runs],
        }
        for path in dict.fromkeys((*main, *titled, *sorted(measured)))
    ]


def _named(path: str) -> dict[str, Any]:
    """Returns label, digits after the point and definition of a field."""
    measure = measures_by_field().get(path)
    if measure is None:
        return {"label": path, "digits": None, "about": ""}
    digits = 3 if measure.share else 2 if float in measure.kinds else 0
    about = LINK.sub(r"\1", measure.text).replace("`", "")
    return {"label": measure.label(path), "digits": digits if measure.title else None, "about": about}


def _numbers(result: RunResult) -> dict[str, float | bool]:
    """Returns all numbers and booleans of a run by path; a list counts by its length, as for criteria."""
    numbers: dict[str, float | bool] = {}
    for path, measure in leaves(result.metrics or {}).items():
        value = len(measure) if isinstance(measure, list) else measure
        if isinstance(value, int | float) and not path.startswith(TOO_FINE):
            numbers[path] = float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
    return numbers


def _case(result: RunResult) -> dict[str, Any]:
    case = result.case
    parameters = {**case.ego.parameters, **dict(case.parameters)}
    return {
        "id": case.id,
        "name": case.name,
        "same": f"{case.scenario}/{case.ego_id}/{case.seed}/{case.draw}",
        "verdict": result.verdict.value,
        "reason": result.reason,
        "scenario": case.scenario,
        "ego": case.ego.name,
        "ego_id": case.ego_id,
        "policy": case.policy,
        "seed": case.seed,
        "parameters": [(name, leaf(value)) for name, value in parameters.items()],
        "events": [[(str(name), leaf(value)) for name, value in event.items()] for event in case.events],
        "wall": None if result.wall_s is None else round(result.wall_s, 2),
    }


def _links(result: RunResult, folder: Path, beside: Path) -> dict[str, str | None]:
    """Returns addresses of report and log of a run relative to `beside`, None if missing; and that of its folder."""
    own = folder / RUNS_FOLDER / result.case.id
    links = {
        name: address(own / file, beside) if file and (own / file).exists() else None
        for name, file in (("report", result.report), ("log", result.log))
    }
    return {**links, "folder": f"{RUNS_FOLDER}/{result.case.id}"}


def address(path: Path, beside: Path) -> str:
    """Returns the address of a file relative to a page in the folder `beside`."""
    return quote(relative(path, beside))


def _happenings(metrics: Mapping[str, Any] | None) -> dict[str, Any]:
    """Returns begin and end of each takeover, and the steps with contacts that are not in the log, of all `steps`."""
    if metrics is None:
        return {"steps": 0, "takeovers": [], "contacts": []}
    begins = ((entry["detected_step"], entry["held_s"]) for entry in metrics["ledger"])
    return {
        "steps": metrics["steps"],
        "takeovers": [[begin, begin + round(held_s / STEP_S)] for begin, held_s in begins],
        "contacts": [contact["step"] for contact in metrics["collision"]["contacts"] if not contact["in_log"]],
    }
