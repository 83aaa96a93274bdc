"""Verdicts on runs, and what is read back of a campaign."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from campaigns import CRITERIA, VERSIONS, cases, metrics, suite
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import (
    CAMPAIGN_FILE,
    RESULT_FILE,
    RunResult,
    Verdict,
    is_campaign,
    read_campaign,
)
from litsim_sim.core.errors import InputError


@pytest.fixture
def case() -> Case:
    return cases(policies=["litsim"])[0]


def test_a_run_is_judged_by_every_criterion(case: Case) -> None:
    passed = RunResult.judged(case, metrics(at_fault=0), CRITERIA)
    assert (passed.verdict, passed.reason) == (Verdict.PASSED, "")
    result = RunResult.judged(case, metrics(at_fault=2), CRITERIA)
    assert result.verdict == Verdict.FAILED
    assert result.reason == "no contact at fault: collision.ego_at_fault is 2, expected at most 0"


def test_a_run_that_is_not_valid_is_an_error_whatever_it_measured(case: Case) -> None:
    result = RunResult.judged(case, metrics(at_fault=0, valid=False, why="ego failed:\n out of memory"), CRITERIA)
    assert result.verdict == Verdict.ERROR
    assert result.reason == "the run is not valid: ego failed: out of memory"
    assert result.metrics is not None


def test_json_keeps_a_result(case: Case) -> None:
    for result in (
        RunResult.judged(case, metrics(at_fault=1), CRITERIA, report="report.html", wall_s=1.5),
        RunResult.error(case, "no answer", log="ads.log"),
    ):
        assert RunResult.from_json(json.loads(json.dumps(result.to_json()))) == result


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "cannot be read"),
        ("[]", "format None, expected 2"),
        ('{"format": 3}', "format 3"),
        ('{"format": 1}', "not a"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / CAMPAIGN_FILE).write_text(text)
    assert is_campaign(tmp_path)
    with pytest.raises(InputError, match=f"{CAMPAIGN_FILE}: {said}"):
        read_campaign(tmp_path)


def test_a_damaged_result_is_named(tmp_path: Path, case: Case) -> None:
    folder = CampaignFolder(tmp_path)
    folder.begin(suite(), [case], VERSIONS)
    run = folder.clear(case)
    again = f"; once the folder {run} is removed, evaluate runs this case again"
    for text, said in (("{", "cannot be read"), ('{"format": 1, "verdict": "good"}', "not a result of a run")):
        (run / RESULT_FILE).write_text(text)
        with pytest.raises(InputError, match=f"{RESULT_FILE}: {said}.*{again}"):
            read_campaign(tmp_path)
    with pytest.raises(InputError, match=f"{RESULT_FILE}: not a result of a run"):
        read_campaign(tmp_path)


def test_a_campaign_by_criteria_that_are_refused_today_is_told_in_one_line(tmp_path: Path) -> None:
    folder = CampaignFolder(tmp_path)
    folder.begin(suite(), cases(policies=["litsim"]), VERSIONS)
    file = tmp_path / CAMPAIGN_FILE
    values = json.loads(file.read_text())
    values["criteria"]["runs"] = [{"name": "never", "field": "takeovers", "max": -1}]
    file.write_text(json.dumps(values))
    with pytest.raises(InputError) as error:
        read_campaign(tmp_path)
    assert str(error.value) == f"{file}: criteria: field runs.0: field takeovers: max is -1, expected 0 or more"
