"""Reading recordings of any known format; formats are recognised by content."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import require_file
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.scenario.cropping import Crop, within
from litsim_sim.scenario.recording import COLUMNS, HEADER_KEY, Recording

__all__ = ["Crop", "load_recording"]

OTHER_TABLES = (
    "any other table needs a mapping: data import TABLE mapping.yaml --draft writes a first one, and data import TABLE "
    "OUT --mapping mapping.yaml reads the table by it"
)


class _Source(Protocol):
    """What is read of a plug-in of ``litsim.sources``: see `litsim_data.sources.source.Source`."""

    content: str

    def recognizes(self, path: Path) -> bool: ...

    def load(self, path: Path, crop: Crop | None) -> Recording: ...


def load_recording(path: Path, crop: Crop | None = None) -> Recording:
    """Read a recording: neutral-schema Parquet, or a file of an installed source that holds one recording.

    `crop` is the [low, high] to keep, both inclusive, by column OF THE FILE; for official NGSIM files by the names
    and in the units of their reader. Raises an InputError if the file is missing or of an unknown format, `crop`
    names an unknown column, is malformed or keeps nothing, or the content fails a check of
    :meth:`Recording.from_table`.
    """
    require_file(path, "recording")
    schema = read_schema(path) if path.suffix == ".parquet" or is_parquet(path) else None
    if schema is not None and HEADER_KEY in (schema.metadata or {}):
        return _neutral(path, crop)
    sources: list[_Source] = [plugins.load(plugins.SOURCES, name)() for name in plugins.names(plugins.SOURCES)]
    for source in sources:
        if source.recognizes(path):
            return source.load(path, crop)
    content = "is no Parquet" if schema is None else f"columns are {list(schema.names)}"
    others = "; ".join(source.content for source in sources)
    raise InputError(
        f"{path}: format not recognised: {content}; expected Parquet of {list(COLUMNS)} with a LitSim header"
        f"{f', or {others}' if others else ''}; {OTHER_TABLES}"
    )


def _neutral(path: Path, crop: Crop | None) -> Recording:
    """Returns the recording in the neutral schema at `path`."""
    recording = Recording.read(path)
    if not crop:
        return recording
    inside = within(recording.columns, len(recording.columns["frame"]), crop, str(path))
    limits = ", ".join(f"{column} within [{float(low):g}, {float(high):g}]" for column, (low, high) in crop.items())
    return Recording.from_columns(recording.header, recording.take(inside).columns, f"{path}, cropped to {limits}")
