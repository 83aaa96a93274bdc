"""Verdicts on runs, and what is read back of a campaign."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from campaigns import CRITERIA, VERSIONS, cases, metrics, stored, suite
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
from litsim_eval.runs.campaign import conclude
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
        assert RunResult.from_json(json.loads(json.dumps(result.to_json())), CRITERIA) == result


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


@pytest.mark.parametrize(
    ("outcome", "edits", "reason"),
    [
        (
            metrics(at_fault=2),
            {"verdict": "passed", "reason": "", "criteria": []},
            "ego_at_fault is 2, expected at most 0",
        ),
        (
            metrics(valid=False, why="ego failed"),
            {"verdict": "passed", "reason": ""},
            "the run is not valid: ego failed",
        ),
        ("no answer", {"verdict": "passed"}, "no answer"),
        ("no answer", {"verdict": "passed", "reason": ""}, "the run has left no measures"),
    ],
)
def test_an_edited_verdict_is_not_believed(tmp_path: Path, outcome: Any, edits: dict[str, Any], reason: str) -> None:
    file = tmp_path / "runs" / stored(tmp_path, [outcome]).cases[0].id / RESULT_FILE
    file.write_text(json.dumps(json.loads(file.read_text()) | edits))
    campaign = read_campaign(tmp_path)
    assert campaign.results[0].verdict != Verdict.PASSED and not campaign.passes
    assert campaign.results[0].reason.endswith(reason)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: text[: len(text) // 2], "cannot be read: "),
        (lambda _: "[" * 100000, "cannot be read: "),
        (lambda _: "", "cannot be read: "),
        (lambda text: text.replace('"agents": 10', '"agents": NaN'), "cannot be read: NaN is no number of JSON"),
        (lambda _: "[]", "format None, expected 2"),
        (lambda text: text.replace('"format": 2', '"format": 3'), "format 3, expected 2"),
        (lambda text: text.replace('"metrics"', '"measures"'), "KeyError: "),
        (lambda text: text.replace('"takeovers"', '"taken"'), "KeyError: "),
        (lambda text: text.replace('"agents": 10', '"agents": "many"'), "field agents is 'many', expected int"),
        (lambda text: text.replace('"ledger": [', '"ledger": [7, '), "TypeError: "),
        (lambda text: text.replace('"id": "', '"id": "0'), "is of case 0"),
    ],
)
def test_a_damaged_result_costs_its_case_not_the_campaign(
    tmp_path: Path, damage: Callable[[str], str], reason: str
) -> None:
    campaign = stored(tmp_path, [metrics(), metrics()])
    file = tmp_path / "runs" / campaign.cases[0].id / RESULT_FILE
    file.write_text(damage(file.read_text()))
    damaged, whole = conclude(CampaignFolder(tmp_path)).results
    assert whole.verdict == Verdict.PASSED
    assert damaged.verdict == Verdict.ERROR and str(file) in damaged.reason and reason in damaged.reason
    assert damaged.reason.endswith("evaluate --retry-errors runs this case again")


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
