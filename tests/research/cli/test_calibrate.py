"""What `calibrate` says about wrong options."""

from typing import Any

import pytest

from litsim_research.cli import calibrate


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--modes", "3", "-1"], "--modes: parameter modes is -1, expected a whole number of at least 0\n"),
        (["--spread", "-1"], "--spread: parameter sigma_scale is -1.0, expected a number of at least 0\n"),
        (["--thresholds", "0"], "--thresholds: [0.0], expected probabilities above 0 and below 1\n"),
    ],
)
def test_wrong_options_are_named(words: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr("sys.argv", ["calibrate", *words])
    with pytest.raises(SystemExit) as stop:
        calibrate.main()
    assert stop.value.code == 2
    assert capsys.readouterr().err == f"error: {said}"
