"""Runs or resumes the campaigns of the paper's experiments, and reads their results."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path

from tqdm import tqdm

from litsim_eval.campaign.case import Case, cases_of, code_versions
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import Campaign, is_campaign, read_campaign
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.campaign import LocalRuns
from litsim_eval.runs.case_run import check_cases, plan_of
from litsim_eval.runs.runner import Runner, record
from litsim_research.paper.experiments import OURS
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.outcomes import RecordedOutcomes, file_of

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


def record_outcomes(suite: Suite, folder: Path, processes: int) -> None:
    """Run the cases of `suite` with policy litsim, and write the outcomes to `folder`; existing files are kept.

    Raises:
        InputError: a case cannot be run, or `folder` cannot be written.
    """
    ours = suite.model_copy(update={"policies": [OURS]})
    missing = [case for case in cases_of(ours) if not file_of(folder, plan_of(case).scenario).is_file()]
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        for _ in tqdm(
            pool.map(_note, missing, [folder] * len(missing)), total=len(missing), unit="run", desc="what happens"
        ):
            pass


def _note(case: Case, folder: Path) -> None:
    plan = plan_of(case)
    run = record(Runner(plan))
    RecordedOutcomes.of_run(plan.scenario.log.ids, run.tables, run.log, plan.scenario.ego_id).write(
        file_of(folder, plan.scenario)
    )
