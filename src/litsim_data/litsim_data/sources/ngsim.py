"""NGSIM: its official files, as published, and the windows of US-101 of the development data.

An official file may hold several recordings (the portal's holds all sites and periods). It is read once, block by
block, and its rows are kept by clock in a temporary folder; then each recording is converted like any other table. So
memory is bounded by a block and by the largest recording.

Layouts: :mod:`litsim_data.ngsim.formats`. Sites and frames: :mod:`litsim_data.ngsim.sites`. Recordings of a file:
:mod:`litsim_data.ngsim.periods`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import get_args
from weakref import finalize

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from litsim_data.generic.loaded_table import TableOfFile
from litsim_data.generic.mapping import Check, Mapping
from litsim_data.ngsim import formats, windows
from litsim_data.ngsim.periods import Clocks, Period
from litsim_data.ngsim.reading import blocks
from litsim_data.ngsim.sites import EXTENT
from litsim_data.sources.source import ReadySource, Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.io.table_input import places
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.recording import BOUNDS, Recording

PUBLISHER = "US DOT / FHWA, doi 10.21949/1504477"
KINDS = {"1": "motorcycle", "2": "car", "3": "truck", "0": "unknown"}
"""Kinds by v_Class; other classes are read as 0."""
COLUMNS = {
    "vehicle_id": "vehicle_id",
    "frame": "frame",
    "x": "global_x",
    "y": "global_y",
    "length": "length",
    "width": "width",
    "speed": "speed",
    "acceleration": "acceleration",
    "kind": "vehicle_class",
    "lane": "lane",
}


class Official(Source):
    """Official files of any number of sites and periods; tracks are in the frames of the nets of the sites."""

    content = "an official NGSIM file (text of 18 or 24 columns, or CSV with its header)"
    licence = "CC BY-SA"
    citation = f"NGSIM ({PUBLISHER})"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return path.suffix != ".parquet" and not is_parquet(path) and formats.detect(path) is not None

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:  # noqa: ARG002 - a file has no map
        """See :class:`.source.Source`."""
        folder, clocks = Path(mkdtemp(prefix="litsim_ngsim_")), Clocks()
        finalize(clocks, rmtree, folder, ignore_errors=True)  # once no scene is left
        _sort_by_clock(path, folder, clocks)
        for period in clocks.periods():
            rows = _Rows((), formats.REQUIRED, path, folder / f"{period.clock}.parquet", clocks, period)
            source = f"NGSIM {period.site.title}, period {period.name.partition('_')[2]} ({PUBLISHER})"
            yield Scene(period.name, rows, _meaning(period), about=(self.licence, source))


class Windows(ReadySource):
    """The US-101 windows file of the development data."""

    content = f"the US-101 windows file (Parquet with columns {', '.join(windows.MARKERS)} among others)"
    licence = Official.licence
    citation = Official.citation

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return is_parquet(path) and windows.is_windows(read_schema(path).names)

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`.source.Source`."""
        return windows.load(path, crop)


@dataclass(frozen=True)
class _Rows(TableOfFile):
    """The rows of one recording, in SI units.

    Attributes:
        stored: Parquet file of all rows of its clock.
        clocks, period: the clocks of the file, and the recording.
    """

    stored: Path
    clocks: Clocks
    period: Period

    def place(self, *rows: int) -> str:
        """See :class:`TableFiles`; rows are lines of the file."""
        return places(self.path, "line", rows)

    def read(self, wanted: list[str], *, needed: set[str] | None = None, whose: str = "") -> pd.DataFrame:  # noqa: ARG002 - all are there
        """See :class:`TableFiles`."""
        if missing := sorted({*wanted} - {*self.columns}):
            raise InputError(f"{self.path}: no columns {missing}; these can be used: {list(self.columns)}")
        rows = pq.read_table(self.stored).to_pandas(split_blocks=True, self_destruct=True)
        rows = rows[self.period.holds(rows["time_ms"].to_numpy())]
        since_zero = rows["time_ms"].to_numpy() - self.clocks.clocks[self.period.clock].origin_ms
        lane = rows["lane"].where(rows["lane"].between(1, BOUNDS["lane"][1]), -1)
        kind = rows["vehicle_class"].where(rows["vehicle_class"].isin([1, 2, 3]), 0)
        frame = np.round(since_zero / (1000.0 * STEP_S)).astype(np.int64)
        rows = rows.assign(frame=frame, lane=lane, vehicle_class=kind)
        return rows[wanted].assign(row=rows["line"])


def _sort_by_clock(source: Path, folder: Path, clocks: Clocks) -> None:
    """Writes the rows of each clock, which is added to `clocks`, to a Parquet file in `folder`, named by its index.

    Raises:
        InputError: a line cannot be used, there are no rows, or they cannot be written.
    """
    writers: dict[int, pq.ParquetWriter] = {}
    try:
        with ExitStack() as opened:
            for rows in blocks(source):
                index = clocks.assign(rows, str(source))
                for clock in np.unique(index).tolist():
                    table = pa.Table.from_pandas(rows[index == clock].drop(columns="site"), preserve_index=False)
                    if clock not in writers:
                        writer = pq.ParquetWriter(folder / f"{clock}.parquet", table.schema, compression="zstd")
                        writers[clock] = opened.enter_context(writer)
                    writers[clock].write_table(table)
    except OSError as error:
        raise InputError(f"{error.filename or folder}: cannot be written or read: {error.strerror or error}") from error
    if not writers:
        raise InputError(f"{source}: holds no rows")


def _meaning(period: Period) -> Mapping:
    """Returns the mapping of the rows of a recording: from metres of the State Plane to frame map of its site."""
    site = period.site
    axes = zip(("global_x", "global_y"), site.global_anchor, strict=True)
    (x,), (y,) = site.map_from_global(np.zeros(1), np.zeros(1))
    fields = {
        "name": period.name,
        "net": site.net,
        "columns": COLUMNS,
        "reference": "front_centre",
        "transform": {"yaw_deg": float(np.rad2deg(site.yaw)), "x": float(x), "y": float(y)},
        "kinds": KINDS,
        "rows": {axis: {"min": middle - EXTENT, "max": middle + EXTENT} for axis, middle in axes},  # on the site
        "clean": True,
        "accept": get_args(Check),  # what is published is what it is
    }
    return Mapping.model_validate(fields)
