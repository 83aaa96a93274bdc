"""The runs of a campaign: each is judged and stored as it comes; what ends early stores nothing of what it ended."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import campaigns
from litsim_eval.campaign.criteria import Criteria, Verdict
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import RunResult, read_campaign
from litsim_eval.campaign.suite import Suite
from litsim_eval.report.thumbnails import read_thumbnail
from litsim_eval.runs import campaign
from litsim_eval.runs.campaign import LocalRuns, conclude
from litsim_eval.runs.case_run import RunOutcome, RunStopped, run_in_process


@pytest.fixture
def begun(tmp_path: Path) -> Callable[..., tuple[list[Any], LocalRuns]]:
    """Begins a campaign; returns its cases and what runs them."""

    def begin(processes: int = 1, **suite: Any) -> tuple[list[Any], LocalRuns]:
        folder = CampaignFolder(tmp_path / "campaign")
        cases = campaigns.cases(**suite)
        folder.begin(campaigns.suite(**suite), cases, campaigns.VERSIONS)
        return cases, LocalRuns(folder, campaigns.CRITERIA, processes)

    return begin


def test_runs_are_judged_and_stored_as_they_come(begun: Callable[..., Any]) -> None:
    roads = [{"scenario": "demo", "ego_id": [7, 3]}]
    cases, runs = begun(2, cases=roads, egos=["log", "idm"], policies=["replay"])
    seen = []
    for result in runs.run(cases):
        seen.append(result)
        assert result in read_campaign(runs.folder.path).results
    assert {result.case.id for result in seen} == {case.id for case in cases}
    found = read_campaign(runs.folder.path)
    assert [result.case for result in found.results] == cases and not found.missing
    for result in found.results:
        assert result.metrics is not None and result.metrics["digest"] == run_in_process(result.case)["digest"]
        (judged,) = result.criteria
        assert judged.passed == (result.metrics["collision"]["ego_at_fault"] == 0)
        assert result.verdict == (Verdict.PASSED if judged.passed else Verdict.FAILED)
        assert read_thumbnail(runs.folder.run_folder(result.case)) is not None


def test_an_error_that_nobody_foresaw_is_the_runs_own(
    begun: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign, "run_over_graph", lambda *_: 1 // 0)
    external = {"kind": "external", "command": ["true"]}
    cases, runs = begun(egos=[external], policies=["replay"])
    (result,) = runs.run(cases)
    assert result.verdict == Verdict.ERROR and result.reason.startswith("ZeroDivisionError")


def test_what_is_interrupted_ends_what_runs_and_stores_nothing_of_it(
    begun: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    under_way = threading.Event()

    def run(case: Any, folder: Path, stopped: Callable[[], bool], limit: float) -> RunOutcome:
        if case.ego_id == 7:
            return RunOutcome(campaigns.metrics(agents=1))
        under_way.set()
        while not stopped():
            pass
        raise RunStopped

    monkeypatch.setattr(campaign, "run_over_graph", run)
    external = {"kind": "external", "command": ["true"]}
    cases, runs = begun(cases=[{"scenario": "demo", "ego_id": [7, 3, 24]}], egos=[external], policies=["replay"])
    results = runs.run(cases)
    assert next(results).case.ego_id == 7
    assert under_way.wait(60.0)
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt)
    assert [result.case.ego_id for result in read_campaign(runs.folder.path).results] == [7]


def test_a_run_that_the_same_signal_has_ended_just_before_the_campaign_is_no_error(
    begun: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = threading.Event()

    def run(case: Any, *_: Any) -> RunOutcome:
        if case.ego_id == 7:
            return RunOutcome(campaigns.metrics(agents=1))
        ended.set()
        return RunOutcome(None, "its process was ended by SIGTERM")

    monkeypatch.setattr(campaign, "run_over_graph", run)
    monkeypatch.setattr(campaign, "SIGNAL_S", 60.0)
    external = {"kind": "external", "command": ["true"]}
    cases, runs = begun(cases=[{"scenario": "demo", "ego_id": [7, 3]}], egos=[external], policies=["replay"])
    results = runs.run(cases)
    assert next(results).case.ego_id == 7
    assert ended.wait(60.0)
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt)
    assert [result.case.ego_id for result in read_campaign(runs.folder.path).results] == [7]


@pytest.mark.parametrize(("started", "most"), [({}, 1), ({"command": ["true"]}, 3)])
def test_a_stack_that_runs_already_drives_in_one_run_at_a_time(
    begun: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, started: dict[str, Any], most: int
) -> None:
    together = threading.Barrier(3)
    running: list[int] = []
    counts: list[int] = []

    def run(case: Any, *_: Any) -> RunOutcome:
        running.append(case.ego_id)
        if most == 3:
            together.wait(60.0)  # all three are here at once
        counts.append(len(running))
        running.remove(case.ego_id)
        return RunOutcome(campaigns.metrics())

    monkeypatch.setattr(campaign, "run_over_graph", run)
    external = {"kind": "external"} | started
    cases, runs = begun(3, cases=[{"scenario": "demo", "ego_id": [7, 3, 24]}], egos=[external], policies=["replay"])
    assert len(list(runs.run(cases))) == 3
    assert max(counts) <= most


def result(case: Any, metrics: dict[str, Any] | None) -> RunResult:
    return RunOutcome(metrics, "" if metrics else "lost").judged(case, campaigns.CRITERIA)


@pytest.mark.parametrize(("share", "verdict"), [(0.3, "passed"), (0.5, "failed")])
def test_the_conclusion_is_by_the_criteria_of_the_suite(tmp_path: Path, share: float, verdict: str) -> None:
    some = {"name": "most pass", "field": "passed_share", "min": share}
    criteria = Criteria(runs=[dict(campaigns.CRITERIA.runs[0])], suite=[some])  # type: ignore[list-item]
    what: dict[str, Any] = {"cases": [{"scenario": "demo", "ego_id": [7, 3, 24]}], "policies": ["replay"]}
    suite: Suite = campaigns.suite(**what, criteria=criteria)
    cases = campaigns.cases(**what)
    folder = CampaignFolder(tmp_path)
    folder.begin(suite, cases, campaigns.VERSIONS)
    measured = run_in_process(cases[0])
    at_fault = measured | {"collision": measured["collision"] | {"ego_at_fault": 1}}
    for case, metrics in zip(cases, (measured, at_fault, None), strict=True):
        folder.clear(case)
        folder.store(result(case, metrics))
    found = conclude(folder)
    assert len(found.results) == 3
    written = json.loads((tmp_path / "results.json").read_text())
    assert (written["name"], written["verdict"]) == ("some", verdict)
    variant = written["variants"]["idm, replay"]
    assert (variant["runs"], variant["measured"], variant["failed"]) == (3, 2, 1)
    assert (variant["passed"], variant["not_passed"], variant["errors"]) == (1, 1, 1)
    assert "3 runs" in (tmp_path / "experiment.html").read_text()
