"""Parquet files that people give: what is wrong is said by file and column."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from litsim_sim.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

MAGIC = b"PAR1"
UNREADABLE = (pa.ArrowException, OSError, UnicodeError)
"""What pyarrow raises on what is no Parquet, or is damaged."""


def is_parquet(path: Path) -> bool:
    """Whether the file at `path` begins as Parquet does; OSError where it cannot be read."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def read_schema(path: Path) -> pa.Schema:
    """The columns of the file at `path`, and its metadata.

    Raises:
        InputError: it is missing, or no Parquet.
    """
    _require(path)
    try:
        schema = pq.read_schema(path)
        _ = schema.names  # text in the file, which pyarrow decodes only now
    except UNREADABLE as error:
        raise _unreadable(path, error) from error
    return schema


def read_arrow(path: Path) -> pa.Table:
    """All columns of the file at `path`, with its metadata.

    Raises:
        InputError: it is missing, or no Parquet.
    """
    _require(path)
    return parse_arrow(path, str(path))


def parse_arrow(source: Path | pa.NativeFile, where: str) -> pa.Table:
    """All columns of the Parquet content in `source`, with its metadata; checksums of pages are checked.

    Args:
        source: a file, or its content as pyarrow reads it.
        where: names it in errors.

    Raises:
        InputError: it is no Parquet, or damaged.
    """
    try:
        with pq.ParquetFile(source, page_checksum_verification=True) as file:  # read_table would import pandas
            table = file.read()
        _ = table.column_names  # text in the file, which pyarrow decodes only now
    except UNREADABLE as error:
        raise _unreadable(where, error) from error
    return table


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


def _unreadable(path: Path | str, error: Exception) -> InputError:
    return InputError(f"{path}: not a readable Parquet file: {' '.join(str(error).split())}")
