"""What `calibrate` says about wrong options."""

import pytest

from command_line import refusal
from litsim_research.cli import calibrate


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--modes", "3", "-1"], "--modes: parameter modes is -1, expected a whole number of at least 0\n"),
        (["--spread", "-1"], "--spread: parameter sigma_scale is -1.0, expected a number of at least 0\n"),
        (["--thresholds", "0"], "--thresholds: [0.0], expected probabilities above 0 and below 1\n"),
    ],
)
def test_wrong_options_are_named(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert refusal(capsys, calibrate.main, *words) == f"error: {said}"
