"""`search` from end to end, in process: margins, files that it leaves, resumption, and the comparison of two."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml
from junitparser import JUnitXml

from command_line import status
from litsim_eval.campaign.case import cases_of, code_versions
from litsim_eval.campaign.suite import Suite
from litsim_eval.cli import compare, evaluate, search
from litsim_eval.search.judging import Outcome
from litsim_eval.search.margins import Margins, compare_margins
from litsim_eval.search.people import People
from litsim_eval.search.search import Search, Settings
from litsim_sim.core.errors import InputError

pytest.importorskip("optuna", reason="Optuna is not installed (requirements/search.txt)")

EGO, LEADER, BESIDE = 1, 2, 3
RUNS = 25


@pytest.fixture(scope="module")
def suite(make_scenario, track, lane_centres, tmp_path_factory) -> Path:
    """A suite in which the ego never brakes, so that it fails once its leader does."""
    tracks = (
        track(EGO, x=100.0, last=100),
        track(LEADER, x=125.0, last=100),
        track(BESIDE, x=112.0, y=lane_centres[2], last=100),
    )
    scenario = make_scenario(*tracks)
    ego = {"name": "blind", "kind": "perturbed", "parameters": {"ego.kind": "keep_speed", "ego.time": [0.0, 0.0]}}
    values: dict[str, Any] = {
        "name": "one",
        "cases": [{"scenario": str(scenario.file.recording).replace(".parquet", ".yaml"), "ego_id": "ego"}],
        "egos": [ego],
        "policies": ["replay"],
    }
    path = tmp_path_factory.mktemp("suite") / "suite.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


@pytest.fixture(scope="module")
def found(suite: Path, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("found") / "out"
    assert status(search.main, "--suite", suite, "--runs", RUNS, "--out", out, "--at-least", 0.5) in (0, 1)
    return out


def test_margin_of_an_ego_that_never_brakes(found: Path) -> None:
    (margin,) = Margins.read(found).scenarios
    assert margin.margin is not None and 0.0 < margin.margin < 4.0
    assert margin.runs <= RUNS and margin.errors == 0 and margin.recorded == Outcome.PASSED
    nearest = margin.failures[0]
    assert nearest.distance == margin.margin == min(each.distance for each in margin.failures)
    assert nearest.holds
    assert nearest.careful_driver and any(f"with {LEADER} at" in each.reason for each in margin.failures)
    assert margin.drawn == round(0.2 * RUNS) and margin.rate is not None and margin.rate[0] <= margin.rate[1]


def test_failures_are_a_suite_with_equal_digests(found: Path, tmp_path: Path) -> None:
    margins = Margins.read(found).scenarios[0]
    assert status(evaluate.main, "--suite", found / "failures.yaml", "--out", tmp_path / "again") == 1
    runs = json.loads((tmp_path / "again/results.json").read_text())["runs"]
    digests = {run["case"]["name"].split("/")[0]: run["metrics"]["digest"] for run in runs}
    assert digests == {each.name: each.digest for each in margins.failures}
    (first, *_) = runs
    assert first["case"]["events"][0]["kind"] == "margin" and first["case"]["tags"]


def test_files(found: Path) -> None:
    margin = Margins.read(found).scenarios[0]
    tried = pq.read_table(found / "tried.parquet").to_pandas()
    assert len(tried) == margin.runs
    assert (tried["outcome"] == "failed").sum() == margin.failed
    worst = tried[tried["outcome"] == "failed"]["distance"].min()
    assert worst == margin.margin
    page = (found / "margins.html").read_text()
    assert page.count("<circle") == margin.runs and margin.failures[0].changes[0] in page
    (test,) = next(iter(JUnitXml.fromfile(str(found / "junit.xml"))))
    assert bool(test.result) == (margin.margin is not None and margin.margin < 0.5)
    changed = yaml.safe_load((found / f"scenarios/{margin.failures[0].name}.yaml").read_text())
    assert changed["changes"] and margin.failures[0].changes[0] in changed["description"]
    assert (found / "tried/experiment.html").is_file()
    assert f'entityRef="agent_{LEADER}"' in (found / f"scenarios/{margin.failures[0].name}.xosc").read_text()


def test_an_interrupted_search_goes_on_with_what_is_there(suite: Path, found: Path, tmp_path: Path) -> None:
    out = shutil.copytree(found, tmp_path / "out")
    results = sorted(out.glob("tried/runs/*/result.json"))
    for path in results[::3]:
        path.unlink()
    before = {path: path.stat().st_mtime_ns for path in results if path.exists()}
    assert status(search.main, "--suite", suite, "--runs", RUNS, "--out", out) in (0, 1)
    assert {path: path.stat().st_mtime_ns for path in before} == before, "no run twice"
    assert all(path.exists() for path in results)
    assert Margins.read(out).scenarios[0].runs == Margins.read(found).scenarios[0].runs


def test_another_search_in_the_folder_is_refused(suite: Path, found: Path, capsys) -> None:
    words = ("--suite", suite, "--runs", RUNS, "--out", found, "--search-seed", 1)
    assert status(search.main, *words) == 2
    assert "holds another search; expected another --out, or --overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--change", "swerve"], "--change swerve"),
        (["--policy", "replay", "yield"], "2 variants: blind, replay; blind, yield; expected one"),
        (["--case", "nowhere"], "no such case"),
        (["--sampler", "luck"], "invalid choice"),
    ],
)
def test_bad_input(suite: Path, tmp_path: Path, capsys, words: list[str], said: str) -> None:
    assert status(search.main, "--suite", suite, "--out", tmp_path / "out", *words) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_optuna(suite: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("litsim_eval.search.search.find_spec", lambda _: None)
    assert status(search.main, "--suite", suite, "--out", tmp_path / "out") == 2
    assert "Optuna is not installed: .venv/bin/pip install -r requirements/search.txt" in capsys.readouterr().err


def test_an_external_stack_is_screened_by_idm(suite: Path, tmp_path: Path) -> None:
    ego = {"name": "mine", "kind": "external", "command": ["true"]}
    path = tmp_path / "external.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(suite.read_text()) | {"egos": [ego]}))
    external, versions = Suite.load(path), code_versions()
    settings = Settings(12, "tpe", 0, (), None, processes=2, time_limit_s=60.0, graph=False)
    cases = cases_of(external, with_versions=versions)
    making = Search(external, cases, versions, People.load(), settings, tmp_path / "out")
    assert making.screen is not None and making.screen.screen is None and making.runs == 24
    making.screen.run()
    assert [case.ego.kind for case in making.screen.all[0].cases.values()] == ["idm"] * 12
    assert len(making.screened(0)) == 3


def test_only_named_changes_vary(suite: Path, tmp_path: Path) -> None:
    status(search.main, "--suite", suite, "--runs", 4, "--change", "start", "--out", tmp_path / "out")
    tried = pq.read_table(tmp_path / "out/tried.parquet").to_pandas()
    assert set(tried["act"]) == {"nothing"} and "start.left" in tried


def changed(margins: Margins, outcome: Outcome = Outcome.PASSED, **values: float | None) -> Margins:
    """Returns margins of several scenarios, by their names."""
    one = margins.scenarios[0].model_copy(update={"recorded": outcome})
    scenarios = [one.model_copy(update={"name": f"{n}/1/blind/replay", "margin": m}) for n, m in values.items()]
    return margins.model_copy(update={"scenarios": scenarios})


def test_margins_of_two_versions(found: Path, tmp_path: Path, capsys) -> None:
    margins = Margins.read(found)
    before = changed(margins, a=2.0, b=3.0, c=None, d=2.5)
    after = changed(margins, a=1.0, b=2.0, c=5.0, d=1.5)
    change = compare_margins(before, after)
    assert change.mean == pytest.approx(-1.0) and change.worse
    assert change.interval is not None and change.interval[1] < 0.0
    assert not compare_margins(after, before).worse
    for name, one in (("before", before), ("after", after)):
        (tmp_path / name).mkdir()
        one.write(tmp_path / name)
    assert status(compare.main, tmp_path / "before", tmp_path / "after") == 1
    printed = capsys.readouterr().out
    assert re.search(r"c/1\s+6.00\s+5.00\s+-1.00", printed) and "mean change -1.00" in printed
    assert status(compare.main, tmp_path / "after", tmp_path / "before") == 0
    with pytest.raises(InputError, match="no scenario in common"):
        compare_margins(before, changed(margins, x=1.0))


def test_a_scenario_is_broken_only_if_it_fails_as_recorded(found: Path) -> None:
    margins = Margins.read(found)
    before, usual = changed(margins, a=1.0), changed(margins, a=0.0)  # at 0, a change as usual as what is recorded
    failing = changed(margins, Outcome.FAILED, a=0.0)
    assert not compare_margins(before, usual).worse and not usual.scenarios[0].short_of(0.0)
    assert compare_margins(usual, failing).worse and compare_margins(usual, failing).broken == ["a/1"]
    assert not compare_margins(failing, failing).worse and failing.scenarios[0].short_of(0.0)
    forced = changed(margins, Outcome.FORCED, a=None)
    assert not forced.scenarios[0].short_of(9.0)
    with pytest.raises(InputError, match="no scenario in common"):
        compare_margins(before, forced)


def test_margins_of_another_format_are_refused(tmp_path: Path) -> None:
    (tmp_path / "margins.json").write_text('{"format": 1, "ego": "idm"}')
    with pytest.raises(InputError, match=r"margins\.json: .*format"):
        Margins.read(tmp_path)
