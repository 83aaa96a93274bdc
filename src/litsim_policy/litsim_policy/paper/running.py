"""The campaigns of the paper's experiments: run where they are not yet, and read."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

from tqdm import tqdm

from litsim_policy.run.campaign import LocalRuns
from litsim_policy.run.case_run import check_cases
from litsim_sim.campaign.case import cases_of, code_versions
from litsim_sim.campaign.folder import CampaignFolder
from litsim_sim.campaign.results import Campaign, read_campaign
from litsim_sim.campaign.suite import Suite
from litsim_sim.core.errors import InputError


def carried_out(suite: Suite, out: Path, processes: int, *, overwrite: bool = False) -> Campaign:
    """The campaign of `suite` in the folder `out`, gone on with where it was.

    Args:
        suite: what is run.
        out: folder of the campaign.
        processes: runs at a time.
        overwrite: whether another campaign there, or one of other sources, is removed; what has been run of this one
            is kept.

    Raises:
        InputError: a run cannot be set up, or another campaign lies there.
    """
    versions = code_versions()
    cases = cases_of(suite, with_versions=versions)
    check_cases(cases)
    folder = CampaignFolder(out)
    runs = LocalRuns(folder, suite.criteria, processes)
    with folder.alone():
        try:
            done = folder.begin(suite, cases, versions)
        except InputError:
            if not overwrite:
                raise
            done = folder.begin(suite, cases, versions, overwrite=True)
        to_run = [case for case in cases if case.id not in done]
        bar = tqdm(total=len(cases), initial=len(done), unit="run", desc=suite.name, dynamic_ncols=True)
        with bar, closing(runs.run(to_run)) as results:
            for _ in results:
                bar.update()
    return read_campaign(out)


class Clock:
    """Wall time of what is done within it [s]."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __enter__(self) -> Clock:
        self._begin = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds += time.monotonic() - self._begin
