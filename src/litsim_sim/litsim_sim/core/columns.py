"""Checks of the columns of tables from outside."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def check_columns(columns: Mapping[str, np.ndarray]) -> None:
    """Check that `columns`, by name, have equal lengths, that ids (n,) ascend, and that all numbers are finite.

    Raises a ValueError that names the column where a check fails.
    """
    ids = columns["id"]
    for name, values in columns.items():
        if len(values) != len(ids):
            raise ValueError(f"{name} has {len(values)} values, expected {len(ids)}, as many as id")
    if len(ids) and (ids[1:] <= ids[:-1]).any():
        at = int((ids[1:] <= ids[:-1]).argmax())
        raise ValueError(f"id {ids[at + 1]} follows {ids[at]}, expected ids that ascend")
    for name, values in columns.items():
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            row = int((~np.isfinite(values)).reshape(len(ids), -1).any(axis=1).argmax())
            wrong = values[row][~np.isfinite(values[row])].flat[0] if values.ndim > 1 else values[row]
            raise ValueError(f"{name} of agent {ids[row]} is {wrong}, expected a finite number")
