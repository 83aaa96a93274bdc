"""Programs of the command line, called in this process."""

from collections.abc import Callable
from typing import Any

import pytest


def status(main: Callable[[list[str]], Any], *words: object) -> int:
    """Returns the exit status of a program with these words."""
    try:
        return int(main([str(word) for word in words]) or 0)
    except SystemExit as stop:
        return int(stop.code or 0)


def refusal(capsys: pytest.CaptureFixture[str], main: Callable[[list[str]], Any], *words: object) -> str:
    """Returns what a program says of words that it refuses."""
    assert status(main, *words) == 2
    return capsys.readouterr().err
