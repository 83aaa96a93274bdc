"""Words on the command lines of this package that nobody knows are refused."""

from __future__ import annotations

import sys

import pytest

from litsim_policy.cli import bench, evaluate, run, training


@pytest.mark.parametrize(
    ("parser", "words"),
    [
        (evaluate.parser, ["--policy", "politeness"]),
        (evaluate.parser, ["--egos", "7;8"]),
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


@pytest.mark.parametrize("program", [training.train, training.train_imitation, training.train_simnet])
def test_training_without_torch_is_told_in_a_line(program, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("litsim_policy.learning")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)  # as if it were not there
    with pytest.raises(SystemExit) as stop:
        program()
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith("error: torch is not installed here")
