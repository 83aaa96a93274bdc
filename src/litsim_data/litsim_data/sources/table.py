"""Any table by its mapping, and recordings in the neutral schema, as sources."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from litsim_data.generic.mapping import Mapping
from litsim_data.sources.source import ReadySource, Scene, Source
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.io.table_input import TableFiles
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import HEADER_KEY, Recording


class MappedTable(Source):
    """CSV or Parquet, one file or several, whose columns a mapping describes; it is made by ``--mapping``."""

    content, licence, citation = "a table with a mapping", "", ""

    def __init__(self, mapping: Mapping, file: Path, more: Sequence[Path] = ()) -> None:
        self._mapping, self._file, self._more = mapping, file, more

    def recognizes(self, path: Path) -> bool:  # noqa: ARG002 - the user has said so
        """See :class:`.source.Source`."""
        return True

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:  # noqa: ARG002 - a table has no map
        """See :class:`.source.Source`."""
        mapping = self._mapping
        name, about = re.sub(r"[^\w+=-]+", "_", mapping.name), (mapping.licence, mapping.source)
        signals = self._file.parent / mapping.signals if mapping.signals else None
        yield Scene(name, TableFiles.open([path, *self._more]), mapping, signals_file=signals, about=about)


class Neutral(ReadySource):
    """LitSim's own recordings."""

    content = "a recording in the neutral schema"
    licence = citation = "as its header says"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return is_parquet(path) and HEADER_KEY in (read_schema(path).metadata or {})

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`.source.Source`."""
        return load_recording(path, crop)
