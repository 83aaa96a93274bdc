"""What is expected of the columns of a table that somebody else has made, whatever the table is of."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def check_columns(columns: Mapping[str, np.ndarray]) -> None:
    """Check that columns hold one value a row, that ids ascend, and that no number is NaN or infinite.

    Args:
        columns: arrays by name, of which `id` is (n,) and tells the rows apart; the others are (n, ...).

    Raises:
        ValueError: they are not so; the message names the column.
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
