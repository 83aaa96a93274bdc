"""Reading recordings of any known format; formats are recognised by content."""

from __future__ import annotations

from pathlib import Path

from litsim_data.ngsim import windows as ngsim_windows
from litsim_sim.core.errors import InputError
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.scenario.cropping import Crop, within
from litsim_sim.scenario.recording import COLUMNS, HEADER_KEY, Recording

__all__ = ["Crop", "load_recording"]

OTHER_TABLES = "any other table needs a mapping: data convert --mapping (one is drafted by data convert --draft)"


def load_recording(path: Path, crop: Crop | None = None) -> Recording:
    """Read a recording, whatever its format.

    Args:
        path: neutral-schema Parquet, the US-101 windows Parquet, or an official NGSIM file of one site and period.
        crop: the [low, high] to keep, both inclusive, by column OF THE FILE; for official NGSIM files by the names and
            in the units of :func:`litsim_data.ngsim.official.read`.

    Raises:
        InputError: the file is missing or of an unknown format; `crop` names an unknown column, is malformed or keeps
            nothing; or the content fails a check of :meth:`Recording.from_table`.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such recording")
    if path.suffix != ".parquet" and not _looks_like_parquet(path):
        from litsim_data.ngsim import formats as ngsim_format
        from litsim_data.ngsim import official as ngsim  # loads scipy, which ready recordings do not need

        if ngsim_format.detect(path) is not None:
            return ngsim.load(path, crop)
        raise InputError(
            f"{path}: format not recognised: neither Parquet nor an official NGSIM file (text of 18 or 24 columns, or "
            f"CSV with its header); {OTHER_TABLES}"
        )
    schema = read_schema(path)
    columns = list(schema.names)
    if ngsim_windows.is_windows(columns):
        return ngsim_windows.load(path, crop)
    if HEADER_KEY in (schema.metadata or {}):
        recording = Recording.read(path)
        if not crop:
            return recording
        kept = within(recording.columns, len(recording.columns["frame"]), crop, str(path))
        left = {name: values[kept] for name, values in recording.columns.items()}
        limits = ", ".join(f"{column} within [{float(low):g}, {float(high):g}]" for column, (low, high) in crop.items())
        return Recording.from_columns(recording.header, left, f"{path}, cropped to {limits}")
    raise InputError(
        f"{path}: format not recognised: columns are {columns}; expected {list(COLUMNS)} with a LitSim header, or the "
        f"US-101 windows file (columns {list(ngsim_windows.MARKERS)} among others); {OTHER_TABLES}"
    )


def _looks_like_parquet(path: Path) -> bool:
    try:
        return is_parquet(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
