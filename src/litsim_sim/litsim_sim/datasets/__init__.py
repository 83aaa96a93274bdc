"""Reading recordings of any known format, recognised by content."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from litsim_sim.datasets import ngsim_windows
from litsim_sim.errors import InputError
from litsim_sim.recording import COLUMNS, HEADER_KEY, Recording

Crop = Mapping[str, Sequence[float]]


def load_recording(path: Path, crop: Crop | None = None) -> Recording:
    """Read a recording, whatever its format.

    Args:
        path: neutral-schema Parquet, or the US-101 windows Parquet.
        crop: by column OF THE FILE, the [low, high] to keep, both inclusive.

    Raises:
        InputError: the file is missing or of no known format, `crop` names an unknown column, is malformed or keeps
            nothing, or the content fails a check of :meth:`Recording.from_table`.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such recording")
    try:
        schema = pq.read_schema(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: not a readable Parquet file: {error}") from error
    columns = list(schema.names)
    if ngsim_windows.is_windows(columns):
        return ngsim_windows.convert(_crop(pd.read_parquet(path), crop, path), str(path))
    if HEADER_KEY in (schema.metadata or {}):
        recording = Recording.read(path)
        if not crop:
            return recording
        return Recording.from_table(recording.header, _crop(recording.table, crop, path), str(path))
    raise InputError(
        f"{path}: format not recognised: columns are {columns}; expected {list(COLUMNS)} with a LitSim header, or the "
        f"US-101 windows file (columns {list(ngsim_windows.MARKERS)} among others)"
    )


def _crop(table: pd.DataFrame, crop: Crop | None, path: Path) -> pd.DataFrame:
    """The rows of `table` within every range of `crop`."""
    keep = np.ones(len(table), np.bool_)
    for column, limits in (crop or {}).items():
        if column not in table.columns:
            raise InputError(f"{path}: crop names unknown column {column!r}; the file has {list(table.columns)}")
        try:
            low, high = (float(limit) for limit in limits)
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}: crop of {column} is {limits!r}, expected [low, high]") from error
        if not pd.api.types.is_numeric_dtype(table[column].dtype):
            raise InputError(f"{path}: crop names column {column!r}, which does not hold numbers")
        values = table[column].to_numpy(np.float64)
        keep &= (values >= low) & (values <= high)
        if not keep.any():
            raise InputError(f"{path}: crop leaves no rows: {column} within [{low}, {high}]")
    return table[keep]
