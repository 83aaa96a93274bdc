"""Marks: clock times that a stage takes while it serves a step, for the analysis of wall time.

The clock is monotonic and shared by all processes of a machine; marks of different machines are not comparable.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from sys import intern


def step_marks(marks: Mapping[str, float]) -> str:
    """Returns the marks of one step, clock times [s] by name, as the `text` of a timing message."""
    return " ".join(f"{name}={time:.6f}" for name, time in marks.items())


def marks_of(text: str) -> dict[str, float]:
    """Inverts :func:`step_marks`; parts of the text that are not marks are ignored."""
    marks = {}
    for part in text.split():
        name, _, value = part.partition("=")
        with suppress(ValueError):
            marks[intern(name)] = float(value)  # few names, of many steps
    return marks
