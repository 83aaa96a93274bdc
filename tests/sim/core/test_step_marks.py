"""Marks on the clock survive the way through a message's text; other words in it do no harm."""

import pytest

from litsim_sim.core.step_marks import marks_of, step_marks


def test_marks_survive_to_the_microsecond() -> None:
    marks = {"begin": 12345.6789012, "answered": 12345.7}
    assert marks_of(step_marks(marks)) == pytest.approx(marks, abs=1e-6, rel=0)


@pytest.mark.parametrize("text", ["", "no marks at all", "begin= answered", "begin=soon"])
def test_words_that_are_no_marks_are_passed_over(text: str) -> None:
    assert marks_of(text) == {}
    assert marks_of(f"{text} free=1.5") == {"free": 1.5}
