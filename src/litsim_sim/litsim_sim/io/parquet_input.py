"""Parquet files that people give: what is wrong is said by file and column."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from litsim_sim.core.errors import InputError


def read_schema(path: Path) -> pa.Schema:
    """The columns of the file at `path`, and its metadata.

    Raises:
        InputError: it is missing, or no Parquet.
    """
    _require(path)
    try:
        return pq.read_schema(path)
    except (pa.ArrowException, OSError) as error:
        raise _unreadable(path, error) from error


def read_arrow(path: Path) -> pa.Table:
    """All columns of the file at `path`, with its metadata.

    Raises:
        InputError: it is missing, or no Parquet.
    """
    _require(path)
    try:
        return pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise _unreadable(path, error) from error


def read_table(path: Path, needed: Sequence[str] = (), *, purpose: str = "") -> pd.DataFrame:
    """Read all columns of the Parquet file at `path`.

    Args:
        path: of the file.
        needed: columns that it must have.
        purpose: said of a file that is missing, such as "calibration needs it".

    Raises:
        InputError: it is missing, no Parquet, or lacks columns.
    """
    _require(path, purpose)
    arrow = read_arrow(path)
    missing = [name for name in needed if name not in arrow.column_names]
    if missing:
        raise InputError(f"{path}: missing columns {missing}; expected {list(needed)}")
    return arrow.to_pandas()


def _require(path: Path, purpose: str = "") -> None:
    if not path.is_file():
        raise InputError(f"{path}: no such file" + (purpose and f"; {purpose}"))


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(f"{path}: not a readable Parquet file: {error}")
