"""Words on the command lines of all packages that nobody knows are refused, in one line."""

import argparse
import re
import sys
from importlib.metadata import EntryPoint, entry_points

import pytest

from command_line import refusal
from litsim_eval.cli import bench, evaluate, run
from litsim_research.cli import training
from litsim_sim.cli.arguments import Parser

PROGRAMS = {each.value: each for each in entry_points(group="console_scripts") if re.search(r"\.cli\b", each.value)}
PROGRAMS = {name: each for name, each in PROGRAMS.items() if name.startswith("litsim_")}


def test_all_programs_are_tried() -> None:
    assert {"litsim_sim.cli.launch:main", "litsim_data.cli:main", "litsim_eval.cli.report:main"} < PROGRAMS.keys()
    assert {"litsim_research.cli.training:main", "litsim_research.cli.score:main"} < PROGRAMS.keys()


@pytest.mark.parametrize("words", [["--no-such-option"], ["--out", ""], ["--out=", "--", ""]])
@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_what_is_wrong_with_options_is_told_in_a_line(
    program: EntryPoint, words: list[str], capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = ["policy"] if program.name == "train" else []
    monkeypatch.setattr(sys, "argv", [program.name, *kind, *words])
    with pytest.raises(SystemExit) as stop:
        program.load()()
    (said,) = capsys.readouterr().err.splitlines()
    assert stop.value.code == 2
    assert said.startswith("error: ") and said.endswith(" --help")
    assert len(words) == 1 or "argument --out: nothing in it, expected a value (is a variable not set?)" in said


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_help_explains_every_option_and_prints_no_lists(program: EntryPoint, monkeypatch: pytest.MonkeyPatch) -> None:
    parsers: list[Parser] = []

    def noted(parser: Parser, *_: object) -> None:
        parsers.append(parser)
        raise SystemExit

    monkeypatch.setattr(Parser, "parse_known_args", noted)
    with pytest.raises(SystemExit):
        program.load()()
    (parser,) = parsers
    options = [each for each in parser._actions if not isinstance(each, argparse._SubParsersAction)]
    assert not [each.dest for each in options if not each.help]
    assert "(default: [" not in parser.format_help() and "(default: (" not in parser.format_help()


@pytest.mark.parametrize(
    ("parser", "words"),
    [
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


@pytest.mark.parametrize("what", ["policy", "imitation", "simnet"])
def test_training_without_torch_is_told_in_a_line(what, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [
        name for name in sys.modules if name.startswith(("litsim_research.policies", "litsim_research.imitation"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)  # as if it were not there
    assert refusal(capsys, training.main, what).startswith("error: torch is not installed here")
