"""Command lines of batches of runs and their table."""

from __future__ import annotations

import json
import sys

import pytest

from litsim_policy.cli import bench, evaluate, run


def test_ways_back_to_the_log_are_rows_of_the_table(monkeypatch, capsys, tmp_path) -> None:
    words = [
        "--policy",
        "replay",
        "yield",
        "--set",
        "conflict.handback=catch_up,time_shift",
        "--egos",
        "7",
        "--processes",
        "2",
    ]
    monkeypatch.setattr(sys, "argv", ["evaluate", "--out", str(tmp_path), *words])
    evaluate.main()
    found = json.loads((tmp_path / "evaluation.json").read_text())["summary"]
    assert list(found) == ["replay", "yield, handback=catch_up", "yield, handback=time_shift"]
    assert found["yield, handback=time_shift"]["held_s"] < found["yield, handback=catch_up"]["held_s"]
    assert "time under control s" in capsys.readouterr().out


def test_seeds_are_runs_of_their_own(monkeypatch, tmp_path) -> None:
    words = ["--ego", "perturbed", "--policy", "replay", "--egos", "3", "--seeds", "1", "2"]
    monkeypatch.setattr(sys, "argv", ["evaluate", "--out", str(tmp_path), *words])
    evaluate.main()
    found = json.loads((tmp_path / "evaluation.json").read_text())
    runs = found["runs"]["replay"]
    assert list(runs) == ["demo/3/1", "demo/3/2"] and found["summary"]["replay"]["runs"] == 2
    assert runs["demo/3/1"]["digest"] != runs["demo/3/2"]["digest"]


@pytest.mark.parametrize(
    ("parser", "words"),
    [
        (evaluate.parser, ["--policy", "politeness"]),
        (evaluate.parser, ["--ego", "external"]),
        (evaluate.parser, ["--processes", "many"]),
        (evaluate.parser, ["--set", "conflict.handback"]),
        (run.parser, ["--set", "conflict.handback=catch_up,time_shift"]),
        (run.parser, ["--ego", "chauffeur"]),
        (run.parser, ["--policy", "politeness"]),
        (bench.parser, ["--agents", "ten"]),
    ],
)
def test_words_that_are_not_known_are_refused(parser, words: list[str], capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        parser().parse_args(words)
    assert stop.value.code == 2 and words[1] in capsys.readouterr().err


def test_unknown_scenarios_and_egos_are_input_errors(monkeypatch, capsys, tmp_path) -> None:
    for words in (
        ["--scenario", "nowhere"],
        ["--egos", "7;8"],
        ["--egos", "tuning"],
        ["--set", "conflict.handback=jump"],
    ):
        monkeypatch.setattr(sys, "argv", ["evaluate", *words, "--out", str(tmp_path)])
        with pytest.raises(SystemExit) as stop:
            evaluate.main()
        assert stop.value.code == 2
        error = capsys.readouterr().err
        assert error.startswith("error: ") and words[-1].rpartition("=")[2] in error and "Traceback" not in error


def test_the_command_line_writes_every_run_and_prints_the_table(monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.setattr(
        sys, "argv", ["evaluate", "--policy", "replay", "--egos", "7", "--processes", "1", "--out", str(tmp_path)]
    )
    evaluate.main()
    written = json.loads((tmp_path / "evaluation.json").read_text())
    assert written["runs"]["replay"]["demo/7"]["collision"]["excess"] > 0
    assert written["summary"]["replay"]["colliding_runs"] == 1
    printed = capsys.readouterr().out
    assert "colliding runs" in printed and "replay" in printed
