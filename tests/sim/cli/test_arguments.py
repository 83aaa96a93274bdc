"""What command lines share."""

import pytest

from litsim_sim.cli.arguments import DefaultsFormatter, Parser


@pytest.fixture
def parser() -> Parser:
    parser = Parser(prog="mine")
    parser.add_argument("--number", type=int, nargs="+", default=[1])
    parser.add_argument("--set", nargs="+")
    parser.add_argument("command", nargs="*")
    return parser


def test_defaults_are_told_as_they_would_be_typed() -> None:
    parser = Parser(prog="mine", formatter_class=DefaultsFormatter)
    parser.add_argument("--spread", nargs="+", type=float, default=[0.5, 1.0], help="scales")
    parser.add_argument("--cost", nargs="*", default=[], help="thresholds")
    said = parser.format_help()
    assert "scales (default: 0.5 1.0)\n" in said and "thresholds\n" in said
    assert parser.parse_args([]).spread == [0.5, 1.0]


def refused(parser: Parser, words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as stop:
        parser.parse_args(words)
    assert stop.value.code == 2
    return capsys.readouterr().err


def test_an_error_is_a_line_that_says_where_help_is(parser: Parser, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(parser, ["--number", "x"], capsys)
    assert said == "error: argument --number: invalid int value: 'x'; see mine --help\n"


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--set", ""], "argument --set"),
        (["--set="], "argument --set"),
        (["--number", "1", "", "2"], "argument --number"),
        ([""], "an argument"),
    ],
)
def test_what_is_empty_is_refused(
    parser: Parser, words: list[str], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert f"error: {what}: nothing in it, expected a value (is a variable not set?)" in refused(parser, words, capsys)


def test_a_list_in_two_parts_is_refused(parser: Parser, capsys: pytest.CaptureFixture[str]) -> None:
    """Only the second part would count."""
    said = refused(parser, ["--set", "a=1", "--number", "1", "--set=b=2"], capsys)
    assert "error: argument --set: comes twice, expected once, with all its values" in said
    assert parser.parse_args(["--set", "a=1", "--", "my_stack", "--set"]).set == ["a=1"]


def test_words_of_a_stack_may_be_empty_and_so_may_values_of_ours(parser: Parser) -> None:
    found = parser.parse_args(["--set", "ego.kind=", "--", "my_stack", "--name=", ""])
    assert (found.set, found.command) == (["ego.kind="], ["my_stack", "--name=", ""])
