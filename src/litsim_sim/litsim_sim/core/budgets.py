"""Budgets: the most that readers take on of what others have written, and the one message beyond.

Checksums tell that bytes are those that were written, not what they ask for: a few of them can demand more memory and
time than a machine has.
"""

from __future__ import annotations

STEPS_MAX = 864_000  # of a run: those of a day
DEFINITION_BYTES_MAX = 65_536  # of a message's definition, which is parsed at 15 kB/s; those in use have 10 kB
LEVELS_MAX = 20  # of messages within messages
CELLS_MAX = 2**28  # of an array that is made for a run, whatever its file holds


def check_budget(what: str, size: float, most: float) -> None:
    """Raise ValueError, by which a reader names its file, if the `size` of something is beyond its budget."""
    if not size <= most:  # NaN, too
        raise ValueError(f"{what}: {size}, expected at most {most}")
