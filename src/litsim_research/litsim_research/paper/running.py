"""Runs or resumes the campaigns of the paper's experiments, and reads their results."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from tqdm import tqdm

from litsim_eval.campaign.case import cases_of, code_versions
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import Campaign, is_campaign, read_campaign
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.campaign import LocalRuns
from litsim_eval.runs.case_run import check_cases
from litsim_sim.core.errors import InputError

SOURCES = "sources"


def carried_out(suite: Suite, out: Path, processes: int, *, overwrite: bool = False) -> Campaign:
    """Run, or resume, the campaign of `suite` in the folder `out`, and return it.

    With `overwrite`, a campaign that was run with other sources is removed; one with the same sources is kept.

    Raises:
        InputError: a run cannot be set up, or the folder contains another campaign.
    """
    versions = code_versions()
    cases = cases_of(suite, with_versions=versions)
    check_cases(cases)
    folder = CampaignFolder(out)
    runs = LocalRuns(folder, suite.criteria, processes)
    with folder.alone():
        before = read_campaign(out).versions.get(SOURCES) if is_campaign(out) else versions[SOURCES]
        has_changed = before != versions[SOURCES]
        if has_changed and not overwrite:
            raise InputError(f"{out}: was run with sources {before}, now {versions[SOURCES]}, expected --overwrite")
        done = folder.begin(suite, cases, versions, overwrite=has_changed, is_part=True)
        to_run = [case for case in cases if case.id not in done]
        bar = tqdm(total=len(cases), initial=len(done), unit="run", desc=suite.name, dynamic_ncols=True)
        with bar, closing(runs.run(to_run)) as results:
            for _ in results:
                bar.update()
    return read_campaign(out)
