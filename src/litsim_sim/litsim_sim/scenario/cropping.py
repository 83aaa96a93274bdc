"""Cropping of tables to ranges of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray

if TYPE_CHECKING:
    import pandas as pd

Crop = Mapping[str, Sequence[float]]
"""The [low, high] to keep, both inclusive, by column."""

NUMBERS = "biuf"
"""NumPy kinds of numeric types."""


def cropped(table: pd.DataFrame, crop: Crop | None, where: str) -> pd.DataFrame:
    """Returns the rows of `table`, called `where`, within every range of `crop`; raises as :func:`within`."""
    return table[within({str(name): column for name, column in table.items()}, len(table), crop, where)]


def within(columns: Mapping[str, Any], rows: int, crop: Crop | None, where: str) -> BoolArray:
    """Returns the mask (`rows`,) of the rows within every range of `crop`; `columns` are arrays or pandas series.

    Raises:
        InputError: `crop` names an unknown column or one without numbers, is malformed, or keeps nothing.
    """
    keep = np.ones(rows, np.bool_)
    for column, limits in (crop or {}).items():
        if column not in columns:
            raise InputError(f"{where}: crop names unknown column {column!r}; the file has {list(columns)}")
        try:
            low, high = (float(limit) for limit in limits)
        except (TypeError, ValueError) as error:
            raise InputError(f"{where}: crop of {column} is {limits!r}, expected [low, high]") from error
        if columns[column].dtype.kind not in NUMBERS:
            raise InputError(f"{where}: crop names column {column!r}, which does not hold numbers")
        values = np.asarray(columns[column], np.float64)
        keep &= (values >= low) & (values <= high)
        if not keep.any():
            raise InputError(f"{where}: crop leaves no rows: {column} within [{low}, {high}]")
    return keep
