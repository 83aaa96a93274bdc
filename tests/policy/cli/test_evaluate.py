"""`evaluate` and `run`: what is wrong with an option is said before the first run, and nothing is ignored."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from litsim_policy.cli import evaluate, run


@pytest.fixture
def scenario(make_scenario, track, tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(make_scenario(track(1, x=100.0, last=20), track(2, x=60.0, last=20)).to_yaml())
    return path


def refused(monkeypatch, capsys, *words: str) -> str:
    """The error of `evaluate` with these words, which is to come before the first run."""
    monkeypatch.setattr(evaluate, "run_batch", lambda *_: pytest.fail("runs have begun"))
    monkeypatch.setattr(sys, "argv", ["evaluate", *words])
    with pytest.raises(SystemExit) as stop:
        evaluate.main()
    assert stop.value.code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--policy", "replay", "--set", "conflct.horizon=2"], "no stage of this run: conflct; expected ego"),
        (
            ["--policy", "yield", "--set", "conflict.horizon=2,-1"],
            "conflict: parameter horizon is -1, expected a number of at least 0.1 [s]",
        ),
        (["--egos", "2,99999"], "--egos 2,99999: 99999"),
        (["--processes", "0"], "'0', expected a whole number of at least 1"),
    ],
)
def test_what_is_wrong_is_said_before_the_first_run(
    monkeypatch, capsys, tmp_path, scenario, words: list[str], said: str
) -> None:
    error = refused(monkeypatch, capsys, "--scenario", str(scenario), "--out", str(tmp_path / "out"), *words)
    assert said in error and "Traceback" not in error


def test_two_files_of_one_name_would_be_one_run_and_are_refused(monkeypatch, capsys, tmp_path, scenario) -> None:
    other = tmp_path / "elsewhere" / scenario.name
    other.parent.mkdir()
    shutil.copy(scenario, other)
    error = refused(monkeypatch, capsys, "--scenario", str(scenario), str(other), "--out", str(tmp_path / "out"))
    assert "short more than once" in error


def test_all_are_those_that_can_be_the_ego(monkeypatch, tmp_path, scenario) -> None:
    words = ["--scenario", str(scenario), "--policy", "replay", "--egos", "all", "--out", str(tmp_path)]
    words += ["--ego", "perturbed", "--set", "ego.kind=brake", "ego.time=[0.0, 0.0]"]
    monkeypatch.setattr(sys, "argv", ["evaluate", *words])
    evaluate.main()
    assert list(json.loads((tmp_path / "evaluation.json").read_text())["runs"]["replay"]) == ["short/1", "short/2"]


def test_a_run_that_fails_is_marked_in_the_table_listed_and_counted(monkeypatch, capsys, tmp_path, scenario) -> None:
    net = tmp_path / "lost.net.xml"
    other = tmp_path / "lost.yaml"
    fields = yaml.safe_load(scenario.read_text())
    shutil.copy(fields["net"], net)
    fields["net"] = str(net)
    other.write_text(yaml.safe_dump(fields))
    whole_batch = evaluate.run_batch

    def without_net(*given: Any) -> Any:
        net.unlink()  # gone after all was checked, before the run
        return whole_batch(*given)

    monkeypatch.setattr(evaluate, "run_batch", without_net)
    words = ["--scenario", str(scenario), str(other), "--egos", "1", "--policy", "replay", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["evaluate", *words])
    with pytest.raises(SystemExit) as stop:
        evaluate.main()
    assert stop.value.code == 1
    said = capsys.readouterr()
    rows = {line.split("│")[1].strip(): line.split("│")[2].strip() for line in said.out.splitlines() if "│" in line}
    assert (rows["runs"], rows["failed runs"]) == ("2", "1")
    assert rows["agents"].endswith("*") and rows["takeovers"].endswith("*") and not rows["reactive %"].endswith("*")
    assert "* over the runs that did not fail: replay: 1 of 2" in " ".join(said.out.split())
    (line,) = [each for each in said.err.splitlines() if each.startswith("error:")]
    assert line.startswith("error: replay: lost/1: failed: ") and "lost.net.xml" in line
    result = json.loads((tmp_path / "evaluation.json").read_text())
    assert list(result["runs"]["replay"]) == ["short/1"] and list(result["failures"]["replay"]) == ["lost/1"]


@pytest.mark.parametrize("policy", ["replay", "yield"])
def test_every_policy_can_be_run(monkeypatch, tmp_path, scenario, policy: str) -> None:
    out = tmp_path / "metrics.json"
    words = ["--scenario", str(scenario), "--policy", policy, "--predictor", "kinematic", "--json", str(out)]
    monkeypatch.setattr(sys, "argv", ["run", *words])
    run.main()
    assert json.loads(out.read_text())["policy"] == policy
