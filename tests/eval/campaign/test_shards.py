"""Shards of a campaign: what is merged is the campaign as it would have run in one folder, and nothing less."""

from pathlib import Path
from typing import Any

import pytest

from campaigns import CRITERIA, VERSIONS, cases, metrics, suite
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import RunResult, read_campaign
from litsim_eval.campaign.shards import merge, shard_of
from litsim_sim.core.errors import InputError

SEEDS = [0, 1, 2]


def run_shard(path: Path, number: int, count: int, *, seeds: list[int] = SEEDS, **fields: Any) -> Path:
    """Runs all but the last case of a shard, each with a record, and returns its folder."""
    folder, plan = CampaignFolder(path / f"{number}"), suite(seeds=seeds, **fields)
    shard, chosen = shard_of(cases(seeds=seeds, **fields), number, count)
    folder.begin(plan, chosen, VERSIONS, shard=shard)
    for case in chosen[:-1]:
        (folder.clear(case) / "run.mcap").write_text(case.name)
        folder.store(RunResult.judged(case, metrics(at_fault=case.seed), CRITERIA, recording="run.mcap"))
    return folder.path


def test_shards_in_any_order_are_the_campaign_again(tmp_path: Path) -> None:
    whole, out = cases(seeds=SEEDS), CampaignFolder(tmp_path / "out")
    folders = [run_shard(tmp_path, number, 2) for number in (2, 1)]
    merge(folders, out)

    campaign = read_campaign(out.path)
    assert campaign.cases == tuple(whole) and campaign.shard is None
    assert campaign.missing == tuple(whole[-2:])  # the last case of each
    shards = [read_campaign(folder) for folder in folders]
    assert {result for shard in shards for result in map(str, shard.results)} == set(map(str, campaign.results))
    assert all((out.run_folder(case) / "run.mcap").read_text() == case.name for case in whole[:-2])
    assert list(out.begin(suite(seeds=SEEDS), whole, VERSIONS)) == [case.id for case in whole[:-2]]  # goes on
    with pytest.raises(InputError, match="holds a campaign already"):
        merge(folders, out)


def test_only_every_shard_of_one_campaign_once_is_merged(tmp_path: Path) -> None:
    first = run_shard(tmp_path, 1, 2)
    milder = Criteria(runs=[{"field": "collision.ego_at_fault", "max": 9}])
    of_another = run_shard(tmp_path / "seeds", 2, 2, seeds=[0, 1])
    judged_otherwise = run_shard(tmp_path / "criteria", 2, 2, criteria=milder)
    of_three = run_shard(tmp_path / "three", 2, 3)
    no_shard = tmp_path / "whole"
    CampaignFolder(no_shard).begin(suite(), cases(), VERSIONS)
    for others in ([], [first], [of_another], [judged_otherwise], [of_three], [no_shard]):
        with pytest.raises(InputError, match=r"1 is 1/2.*expected each part of one campaign"):
            merge([first, *others], CampaignFolder(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_more_parts_than_cases_are_refused() -> None:
    with pytest.raises(InputError, match="--part 7/9: no case is left, expected at most 6 parts"):
        shard_of(cases(seeds=SEEDS), 7, 9)
