"""What is foreign is printed short and without what steers a terminal."""

import pytest

from litsim_sim.core.errors import LONGEST, SHOWN_MAX, print_error, printable, shown


def test_an_error_is_printed_short_and_without_control_characters(capsys: pytest.CaptureFixture[str]) -> None:
    print_error("frame \x1b[31mred\x1b[2J\a, " + 2_000_000 * "x")
    error = capsys.readouterr().err
    assert error.startswith("error: frame \\x1b[31mred\\x1b[2J\\x07, xx") and error.endswith("xx\n")
    assert LONGEST < len(error) < 1.1 * LONGEST
    assert printable(f"it is {1e308:.1f} m away") == "it is 100000... (309 digits).0 m away"
    assert printable("Ä → 3 m/s²\nsecond line") == "Ä → 3 m/s²\nsecond line"


@pytest.mark.parametrize("value", ["x" * 10**6, 10**1000, [[0] * 10**4] * 10**4, {str(i): [i] for i in range(10**4)}])
def test_a_value_is_shown_short_whatever_it_is(value: object) -> None:
    assert len(shown(value)) <= SHOWN_MAX


def test_a_short_value_is_shown_whole() -> None:
    assert shown({"a": [1, "b", 2.5]}) == "{'a': [1, 'b', 2.5]}"
