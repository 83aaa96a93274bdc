"""The verdict on a run in its report, which a campaign or the launcher gives after the report is written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from litsim_eval.campaign.criteria import CriterionResult
from litsim_eval.campaign.results import EXPERIMENT_REPORT_FILE, RUNS_FOLDER, Campaign, rerun_command
from litsim_eval.report.campaign_content import address
from litsim_sim.io.files import write_text

BEGIN, END = '<script id="verdict" type="application/json">', "</script>"


def verdict_text(
    verdict: str, reason: str, criteria: Sequence[CriterionResult], *, campaign: str = "", rerun: str = ""
) -> str:
    """Returns what a report reads as the verdict on its run, as JSON that can stand in a script of a page.

    Args:
        verdict: passed, failed or error.
        reason: why it is no pass.
        criteria: results of the criteria.
        campaign: address of the run in the page of its campaign, relative to the report.
        rerun: command that runs it again.
    """
    values = {
        "verdict": verdict,
        "reason": reason,
        "criteria": [asdict(criterion) for criterion in criteria],
        "campaign": campaign,
        "rerun": rerun,
    }
    return json.dumps(values, allow_nan=False).replace("<", "\\u003c")


def verdict_in(page: Path) -> str:
    """Returns what a report reads as its verdict, as :func:`verdict_text` does; empty without a page or a verdict."""
    if not page.is_file():
        return ""
    return page.read_text(encoding="utf-8", errors="replace").partition(BEGIN)[2].partition(END)[0]


def show_verdicts(campaign: Campaign) -> None:
    """Writes the verdicts of a campaign into the reports of its runs, where they are not there yet.

    Raises:
        Unwritable: a report cannot be written.
    """
    for result in campaign.results:
        page = campaign.folder / RUNS_FOLDER / result.case.id / (result.report or "")
        if not (result.report and page.is_file()):
            continue
        link = f"{address(campaign.folder / EXPERIMENT_REPORT_FILE, page.parent)}#run={result.case.id}"
        rerun = rerun_command(campaign.folder, result.case)
        text = verdict_text(result.verdict.value, result.reason, result.criteria, campaign=link, rerun=rerun)
        before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
        old, end, after = rest.partition(END)
        if begin and end and old != text:
            write_text(page, f"{before}{begin}{text}{end}{after}")
