"""Tables by their mappings, the user's or the package's, and recordings in the neutral schema, as sources."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from litsim_data.generic.mapping import Mapping
from litsim_data.generic.published import mapping_of
from litsim_data.generic.wide import open_tables
from litsim_data.sources.source import ReadySource, Scene, Source
from litsim_sim.io.parquet_input import is_parquet, read_schema
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
        tracks = open_tables([path, *self._more], mapping.repeated)
        yield Scene(name, tracks, mapping, signals_file=signals, about=about)


class PublishedTable(Source):
    """Tables of data sets whose columns a mapping of the package describes."""

    content = "a table of CitySim, I-24 MOTION, pNEUMA, SinD or Songdo"
    licence = citation = "as the mapping says"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return mapping_of(path) is not None

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        published = mapping_of(path)
        assert published is not None  # it is recognised
        file, mapping = published
        named = mapping.model_copy(update={"name": f"{mapping.name}_{path.name.partition('.')[0]}"})
        yield from MappedTable(named, file).read(path, lanes)


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
