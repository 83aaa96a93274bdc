"""Cutting tables to ranges of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from litsim_sim.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

Crop = Mapping[str, Sequence[float]]
"""By column, the [low, high] to keep, both inclusive."""


def cropped(table: pd.DataFrame, crop: Crop | None, where: str) -> pd.DataFrame:
    """The rows of `table` within every range of `crop`; `where` names the table in errors.

    Raises:
        InputError: `crop` names an unknown column or one without numbers, is malformed, or keeps nothing.
    """
    from pandas.api.types import is_numeric_dtype

    keep = np.ones(len(table), np.bool_)
    for column, limits in (crop or {}).items():
        if column not in table.columns:
            raise InputError(f"{where}: crop names unknown column {column!r}; the file has {list(table.columns)}")
        try:
            low, high = (float(limit) for limit in limits)
        except (TypeError, ValueError) as error:
            raise InputError(f"{where}: crop of {column} is {limits!r}, expected [low, high]") from error
        if not is_numeric_dtype(table[column].dtype):
            raise InputError(f"{where}: crop names column {column!r}, which does not hold numbers")
        values = table[column].to_numpy(np.float64)
        keep &= (values >= low) & (values <= high)
        if not keep.any():
            raise InputError(f"{where}: crop leaves no rows: {column} within [{low}, {high}]")
    return table[keep]
