"""The folder of a campaign: how a campaign is gone on with, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from campaigns import CRITERIA, EGO, VERSIONS, cases, metrics, suite
from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.comparison import compare_campaigns
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import (
    CAMPAIGN_FILE,
    RunResult,
    Verdict,
    read_campaign,
)
from litsim_sim.core.errors import InputError


@pytest.fixture
def case() -> Case:
    return cases(policies=["litsim"])[0]


def test_a_finished_case_is_not_left_to_do_and_an_unfinished_one_leaves_nothing(tmp_path: Path) -> None:
    first, second = made = cases()
    folder = CampaignFolder(tmp_path)
    assert folder.begin(suite(), made, VERSIONS) == {}
    folder.clear(first)
    folder.store(RunResult.judged(first, metrics(), CRITERIA))
    (folder.clear(second) / "half.mcap").write_text("killed here")

    done = CampaignFolder(tmp_path).begin(suite(), made, VERSIONS)

    assert list(done) == [first.id] and done[first.id].verdict == Verdict.PASSED
    assert not folder.run_folder(second).exists()
    campaign = read_campaign(tmp_path)
    assert campaign.cases == tuple(made) and campaign.missing == (second,)
    assert campaign.results == (done[first.id],)
    assert campaign.criteria == CRITERIA and campaign.versions == VERSIONS


def test_going_on_keeps_when_it_began(tmp_path: Path) -> None:
    CampaignFolder(tmp_path).begin(suite(), cases(), VERSIONS)
    file = tmp_path / CAMPAIGN_FILE
    values = json.loads(file.read_text()) | {"begun_at": "2020-01-01T00:00:00+00:00"}
    file.write_text(json.dumps(values))
    CampaignFolder(tmp_path).begin(suite(), cases(), VERSIONS)
    assert read_campaign(tmp_path).begun_at == values["begun_at"]


def test_more_cases_may_be_asked_for_and_other_ones_may_not(tmp_path: Path) -> None:
    few, many, other = cases(), cases(seeds=[0, 1]), cases(egos=["log"])
    CampaignFolder(tmp_path).begin(suite(), few, VERSIONS)
    CampaignFolder(tmp_path).begin(suite(), many, VERSIONS)
    said = rf"another campaign: 4 of its 4 cases .* such as demo/{EGO}/idm/replay/0; .*--ove"
    with pytest.raises(InputError, match=said):
        CampaignFolder(tmp_path).begin(suite(), other, VERSIONS)
    assert len(read_campaign(tmp_path).cases) == 4


def test_what_has_changed_is_run_again_and_its_verdict_is_kept(tmp_path: Path) -> None:
    """As in a CI job with a kept folder, after a change of the stack: a new version of one of two."""
    stack = tmp_path / "stack.py"
    stack.write_text("brake = 1")
    egos = ["log", {"name": "mine", "kind": "external", "command": ["python3", str(stack)]}]
    folder, plan = CampaignFolder(tmp_path / "out"), suite(egos=egos, policies=["replay"])
    other, first = made = cases(egos=egos, policies=["replay"])
    folder.begin(plan, made, VERSIONS)
    for case, at_fault in ((other, 0), (first, 1)):
        folder.clear(case)
        folder.store(RunResult.judged(case, metrics(at_fault), CRITERIA, report="report.html"))
    for name in ("report.html", "run.mcap"):
        (folder.run_folder(first) / name).touch()

    stack.write_text("brake = 2")
    _, changed = again = cases(egos=egos, policies=["replay"])
    assert folder.changes(again, VERSIONS) == {f"{stack} has changed": 1}
    done = folder.begin(plan, again, VERSIONS)

    assert list(done) == [other.id] and changed.id != first.id
    assert not folder.run_folder(first).exists()
    assert folder.changes(again, VERSIONS) == {}
    (kept,) = folder.history
    earlier = read_campaign(kept)
    assert [(each.case.name, each.verdict) for each in earlier.results] == [
        (other.name, Verdict.PASSED),
        (first.name, Verdict.FAILED),
    ]
    left = {path.name for path in (kept / "runs" / first.id).iterdir()}
    assert left == {"result.json", "report.html"}
    folder.store(RunResult.judged(changed, metrics(), CRITERIA))
    comparison = compare_campaigns(earlier, read_campaign(tmp_path / "out"))
    assert [pair.case.name for pair in comparison.those("newly_passing")] == [first.name]
    assert folder.begin(plan, again, VERSIONS, overwrite=True) == {} and not folder.history


def test_keeping_verdicts_may_be_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, made, later = CampaignFolder(tmp_path), cases(), VERSIONS | {"sources": "c"}
    folder.begin(suite(), made, VERSIONS)
    for case in made:
        folder.clear(case)
        folder.store(RunResult.judged(case, metrics(), CRITERIA))
    again = cases_of(suite(), with_versions=later)
    moved: list[Path] = []

    def killed(source: Path, target: Path) -> None:
        if moved:
            raise KeyboardInterrupt
        moved.append(source.rename(target))

    with monkeypatch.context() as patch:
        patch.setattr("litsim_eval.campaign.folder.shutil.move", killed)
        with pytest.raises(KeyboardInterrupt):
            folder.begin(suite(), again, later)
    folder.begin(suite(), again, later)
    assert [result.case for result in read_campaign(folder.history[0]).results] == made


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"versions": VERSIONS | {"sources": "c"}}, "LitSim itself has changed"),
        ({"versions": VERSIONS | {"python": "4"}}, "python 3, now 4: has changed"),
        ({"parameters": {"ego.time_gap": [2.0]}}, "the parameters have changed"),
        ({"egos": [{"name": "idm", "kind": "log"}]}, 'kind of ego idm was "idm", is "log"'),
        ({"policies": ["replay"]}, "not in the suite any more"),
    ],
)
def test_why_a_case_has_changed(tmp_path: Path, change: dict[str, Any], why: str) -> None:
    fields = dict(change)
    versions = fields.pop("versions", VERSIONS)
    folder = CampaignFolder(tmp_path)
    folder.begin(suite(), cases(), VERSIONS)
    assert list(folder.changes(cases_of(suite(**fields), with_versions=versions), versions)) == [why]


def test_a_part_does_not_take_the_place_of_its_campaign(tmp_path: Path) -> None:
    folder, whole = CampaignFolder(tmp_path), cases()
    folder.begin(suite(), whole, VERSIONS)
    with pytest.raises(InputError, match=r"holds more than this part of a suite: 1 of its 2 cases .*--overwrite"):
        folder.begin(suite(), whole[:1], VERSIONS, is_part=True)


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_others_have_in_the_folder_stays(tmp_path: Path, *, overwrite: bool) -> None:
    made = cases()
    theirs = tmp_path / "runs" / "exp1" / "weights.pt"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("of a training")
    if overwrite:
        CampaignFolder(tmp_path).begin(suite(), made, VERSIONS)
    CampaignFolder(tmp_path).begin(suite(), made, VERSIONS, overwrite=overwrite)
    assert theirs.read_text() == "of a training"


def test_overwriting_leaves_no_verdicts_of_before(tmp_path: Path) -> None:
    made, folder = cases(), CampaignFolder(tmp_path)
    folder.begin(suite(), made, VERSIONS)
    folder.store(RunResult.judged(made[0], metrics(), CRITERIA))
    for name in ("junit.xml", "experiment.html", "results.json", "results.parquet"):
        (tmp_path / name).write_text("passed")
    assert folder.begin(suite(egos=["log"]), cases(egos=["log"]), VERSIONS, overwrite=True) == {}
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} <= {CAMPAIGN_FILE, ".lock"}


def test_a_run_whose_folder_cannot_be_made_is_told(tmp_path: Path, case: Case) -> None:
    folder = CampaignFolder(tmp_path)
    folder.run_folder(case).parent.mkdir()
    folder.run_folder(case).write_text("a file")
    with pytest.raises(InputError, match=rf"runs/{case.id}: cannot be made: File exists"):
        folder.clear(case)


def test_other_criteria_judge_what_was_measured_again(tmp_path: Path) -> None:
    first, second = made = cases()
    folder = CampaignFolder(tmp_path)
    folder.begin(suite(), made, VERSIONS)
    folder.store(RunResult.judged(first, metrics(at_fault=1), CRITERIA, report="report.html"))
    folder.store(RunResult.error(second, "no answer"))
    milder = Criteria(runs=[{"field": "collision.ego_at_fault", "max": 1}])

    done = folder.begin(suite(criteria=milder), made, VERSIONS)

    assert done[first.id].verdict == Verdict.PASSED and done[first.id].report == "report.html"
    assert done[second.id].verdict == Verdict.ERROR
    assert read_campaign(tmp_path).results[0].verdict == Verdict.PASSED


def test_a_suite_told_more_since_tells_it_of_old_results(tmp_path: Path) -> None:
    made = cases()
    folder = CampaignFolder(tmp_path)
    folder.begin(suite(), made, VERSIONS)
    folder.store(RunResult.judged(made[0], metrics(), CRITERIA))
    tagged = cases(cases=[{"scenario": "demo", "ego_id": "ego", "tags": ["hard"]}])
    assert folder.begin(suite(), tagged, VERSIONS)[made[0].id].case.tags == ("hard",)


def test_all_results_in_one_file(tmp_path: Path, case: Case) -> None:
    folder = CampaignFolder(tmp_path)
    result = RunResult.judged(case, metrics(), CRITERIA)
    path = folder.write_results([result], variants={"idm, litsim": {"runs": 1}})
    values = json.loads(path.read_text())
    assert values["variants"] == {"idm, litsim": {"runs": 1}}
    assert [RunResult.from_json(each, CRITERIA) for each in values["runs"]] == [result]


def test_two_at_a_time_are_refused(tmp_path: Path) -> None:
    first, second = CampaignFolder(tmp_path), CampaignFolder(tmp_path)
    said = "another campaign is running here"
    with first.alone(), pytest.raises(InputError, match=said), second.alone():
        pass
    with second.alone():
        assert tmp_path.is_dir()
