"""Shards of a campaign: parts of its cases that run in folders and on machines of their own, and their merging."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from litsim_eval.campaign.case import Case, digest
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import Shard, read_campaign
from litsim_eval.campaign.suite import CAMPAIGN_FILE
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_json


def shard_of(cases: Sequence[Case], number: int, count: int) -> tuple[Shard, list[Case]]:
    """Returns shard `number` of `count`, from 1 on, and its cases: every `count`-th of `cases`, in their order.

    Raises:
        InputError: it has no cases.
    """
    if number > len(cases):
        raise InputError(f"--part {number}/{count}: no case is left, expected at most {len(cases)} parts")
    shard = Shard(digest({"cases": [case.id for case in cases]}), count, number)
    return shard, list(cases[number - 1 :: count])


def merge(folders: Sequence[Path], out: CampaignFolder) -> None:
    """Makes in `out` the campaign whose shards are in `folders`, with all files of its runs.

    Raises:
        InputError: `folders` are not each shard of one campaign, once, or `out` holds a campaign or cannot be used.
    """
    if (out.path / CAMPAIGN_FILE).exists():
        raise InputError(f"{out.path}: holds a campaign already, expected another --out")
    campaigns = [read_campaign(folder) for folder in folders]
    by_shard = {campaign.shard: campaign for campaign in campaigns if campaign.shard is not None}
    least = min(by_shard, default=None)
    expected = [] if least is None else [replace(least, number=number + 1) for number in range(least.count)]
    alike = all(campaign.criteria == campaigns[0].criteria for campaign in campaigns)
    if sorted(by_shard) != expected or len(campaigns) != len(expected) or not alike:
        given = ", ".join(f"{campaign.folder} is {campaign.shard or 'no part'}" for campaign in campaigns)
        raise InputError(f"{given}; expected each part of one campaign, by the same suite, options, files and versions")
    cases: list[Any] = [None] * sum(len(campaign.cases) for campaign in campaigns)
    for shard, campaign in by_shard.items():
        cases[shard.number - 1 :: shard.count] = [case.to_json() for case in campaign.cases]
        for result in campaign.results:
            run = CampaignFolder(campaign.folder).run_folder(result.case)
            try:
                shutil.copytree(run, out.run_folder(result.case), dirs_exist_ok=True)
            except OSError as error:
                raise InputError(f"{run}: cannot be copied to {out.path}: {error}") from error
    described = json.loads((folders[0] / CAMPAIGN_FILE).read_text(encoding="utf-8"))
    write_json(out.path / CAMPAIGN_FILE, described | {"cases": cases, "shard": None})
