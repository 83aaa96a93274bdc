"""Bounds on what others have written: budgets, and columns of tables.

Checksums tell that bytes are those that were written, not what they ask for: a few of them can demand more memory and
time than a machine has.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

STEPS_MAX = 864_000  # of a run: those of a day
DEFINITION_BYTES_MAX = 65_536  # of a message's definition, which is parsed at 15 kB/s; those in use have 10 kB
LEVELS_MAX = 20  # of messages within messages
CELLS_MAX = 2**28  # of an array that is made for a run, whatever its file holds


def check_budget(what: str, size: float, most: float) -> None:
    """Raise ValueError, by which a reader names its file, if the `size` of something is beyond its budget."""
    if not size <= most:  # NaN, too
        raise ValueError(f"{what}: {size}, expected at most {most}")


def check_columns(columns: Mapping[str, np.ndarray]) -> None:
    """Check that `columns`, by name, have equal lengths, that ids (n,) ascend, and that all numbers are finite.

    Raises a ValueError that names the column where a check fails.
    """
    ids = columns["id"]
    for name, values in columns.items():
        if len(values) != len(ids):
            raise ValueError(f"{name} has {len(values)} values, expected {len(ids)}, as many as id")
    if len(ids) and (ids[1:] <= ids[:-1]).any():
        place = int((ids[1:] <= ids[:-1]).argmax())
        raise ValueError(f"id {ids[place + 1]} follows {ids[place]}, expected ids that ascend")
    for name, values in columns.items():
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            row = int((~np.isfinite(values)).reshape(len(ids), -1).any(axis=1).argmax())
            wrong = values[row][~np.isfinite(values[row])].flat[0] if values.ndim > 1 else values[row]
            raise ValueError(f"{name} of agent {ids[row]} is {wrong}, expected a finite number")
