"""Where the wall time of a step goes: the marks that a stage sets on the clock while it serves a step.

The clock is the monotonic one, which all processes of a machine share; marks of different machines do not compare.
"""

from __future__ import annotations

from collections.abc import Mapping


def step_marks(marks: Mapping[str, float]) -> str:
    """Marks of one step, times of the performance counter [s] by name, as the `text` of a stage's timing."""
    return " ".join(f"{name}={time:.6f}" for name, time in marks.items())


def marks_of(text: str) -> dict[str, float]:
    """The marks that :func:`step_marks` wrote [s]; words that are no marks are passed over."""
    found = {}
    for word in text.split():
        name, _, value = word.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            continue
    return found
