"""Reading of Parquet files of users; errors name file and column."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import read_head, require_file, unpacked_max

if TYPE_CHECKING:
    import pandas as pd

CELL_BYTES = 8  # [B] of a number in memory
MAGIC = b"PAR1"
PLAIN = {
    {"float32": "float", "float64": "double"}.get(name, name): np.dtype(name)
    for name in ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64")
}
"""Types of numbers, by Arrow's names."""
UNREADABLE = (pa.ArrowException, OSError, UnicodeError)
"""Exceptions that pyarrow raises for files that are damaged or not Parquet."""


def is_parquet(path: Path) -> bool:
    """Returns whether a file begins like a Parquet file; raises InputError if it cannot be read."""
    return read_head(path, len(MAGIC)) == MAGIC


def read_schema(path: Path) -> pa.Schema:
    """Returns the columns of a file, and its metadata; raises InputError if it is missing, or no Parquet."""
    require_file(path)
    try:
        schema = pq.read_schema(path)
        _ = schema.names  # text in the file, which pyarrow decodes only now
    except UNREADABLE as error:
        raise _unreadable(path, error) from error
    return schema


def read_arrow(path: Path) -> pa.Table:
    """Returns all columns of a file, with its metadata; raises InputError if it is missing, or no Parquet."""
    require_file(path)
    return parse_arrow(path, str(path))


def parse_arrow(source: Path | pa.NativeFile, where: str) -> pa.Table:
    """Returns all columns of the Parquet content in `source`, with its metadata; checksums of pages are checked.

    Raises an InputError, in which `where` names the source, if it is no Parquet, or damaged.
    """
    try:
        with pq.ParquetFile(source, page_checksum_verification=True) as file:  # read_table would import pandas
            packed = source.stat().st_size if isinstance(source, Path) else source.size()
            check_unpacked(file.metadata, packed, where)
            table = file.read()
        _ = table.column_names  # text in the file, which pyarrow decodes only now
    except UNREADABLE as error:
        raise _unreadable(where, error) from error
    return table


def check_unpacked(content: pq.FileMetaData, packed: int, where: str) -> None:
    """Raise InputError about `where` if a file of `packed` bytes holds far more than such files do."""
    numbers = CELL_BYTES * content.num_rows * content.num_columns
    size = max(numbers, sum(content.row_group(k).total_byte_size for k in range(content.num_row_groups)))
    if size > (most := unpacked_max(packed)):
        raise InputError(f"{where}: unpacks from {packed} to {size} bytes, expected at most {most}")


def read_table(path: Path, needed: Sequence[str] = ()) -> pd.DataFrame:
    """Read all columns of the Parquet file at `path`.

    Raises an InputError if it is missing, no Parquet, or lacks one of the `needed` columns.
    """
    arrow = read_arrow(path)
    missing = [name for name in needed if name not in arrow.column_names]
    if missing:
        raise InputError(f"{path}: missing columns {missing}; expected {list(needed)}")
    return arrow.to_pandas()


def plain_columns(arrow: pa.Table) -> dict[str, np.ndarray]:
    """Returns the columns of plain numbers, as arrays; gaps in columns of floats are NaN.

    Left out are columns of other types, of integers with gaps, with names that occur twice, and those that are an index
    in pandas. Arrow's own conversion would import pandas, which takes longer than anything else that a run reads.
    """
    names, index = arrow.column_names, (arrow.schema.pandas_metadata or {}).get("index_columns", [])
    return {
        name: np.concatenate([np.empty(0, dtype), *(_values(chunk, dtype) for chunk in column.chunks)])
        for name, column in zip(names, arrow.columns, strict=True)
        if (dtype := PLAIN.get(str(column.type))) is not None
        and names.count(name) == 1
        and name not in index
        and (dtype.kind == "f" or not column.null_count)
    }


def _values(chunk: pa.Array, dtype: np.dtype) -> np.ndarray:
    """Returns the numbers of a part of a column, NaN where it has gaps."""
    gaps, numbers = chunk.buffers()
    own = slice(chunk.offset, chunk.offset + len(chunk))
    values = np.frombuffer(numbers, dtype)[own]
    if not chunk.null_count:
        return values
    there = np.unpackbits(np.frombuffer(gaps, np.uint8), bitorder="little")[own].astype(np.bool_)
    return np.where(there, values, dtype.type(np.nan))


def _unreadable(path: Path | str, error: Exception) -> InputError:
    return InputError(f"{path}: not a readable Parquet file: {' '.join(str(error).split())}")
