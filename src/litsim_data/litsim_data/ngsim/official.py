"""Reading and conversion of official NGSIM files, as published, in bounded memory.

A file may hold several recordings (the portal's holds all sites and periods). A conversion reads the file once, block
by block, and keeps its rows by clock in a temporary folder beside the result; then the recordings are made one by one.
Memory is bounded by a block and by the largest recording.

Layouts: :mod:`.formats`, read by :mod:`.reading`. Sites and frames: :mod:`.sites`. Recordings of a file:
:mod:`.periods`. Repairs: :mod:`.tracks`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from tqdm import tqdm

from litsim_data.cleaning.cleaning import CleaningReport
from litsim_data.ngsim import tracks as ngsim_tracks
from litsim_data.ngsim.periods import Clocks, Period
from litsim_data.ngsim.reading import blocks, on_site
from litsim_data.ngsim.sites import SITES
from litsim_data.ngsim.tracks import RepairCounts
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.files import Unwritable
from litsim_sim.scenario.cropping import Crop, cropped
from litsim_sim.scenario.recording import Recording, RecordingHeader

LICENCE = "CC BY-SA"
PUBLISHER = "US DOT / FHWA, doi 10.21949/1504477"


@dataclass(frozen=True)
class Converted:
    """One recording made by a conversion.

    Attributes:
        path: its file.
        name: its name.
        rows, vehicles: their numbers.
        mended: counts of repaired defects of the file.
        cleaning: figures before and after cleaning, as text; empty if it was not cleaned.
    """

    path: Path
    name: str
    rows: int
    vehicles: int
    mended: RepairCounts
    cleaning: str


def read(path: Path, columns: Sequence[str], site: str | None = None) -> pd.DataFrame:
    """Returns the rows of an official file in SI units, neither repaired nor cleaned, for fitting maps.

    Args:
        path: official file.
        columns: names in ``formats.NAMES`` to read.
        site: key of ``SITES`` to keep; None for all.

    Returns:
        In the order of the file: the columns (metres, seconds; `global_x`, `global_y` in metres of the State Plane;
        -1 for unknown integers), vehicle_id, frame, and `recording` (such as us101_0750), `x`, `y` (FRONT centre, frame
        map [m]), `line`. `frame` counts from the same instant within a recording.

    Raises:
        InputError: it is not an official file, a line cannot be used, or no row is of that site.
    """
    parts, clocks = [], Clocks()
    for rows in blocks(path, ["vehicle_id", "frame", *columns]):
        here = rows if site is None else rows[rows["site"] == list(SITES).index(site)]
        parts.append(here.assign(clock=clocks.assign(here, str(path))))
    if not clocks.periods():
        raise InputError(f"{path}: holds no rows{f' of site {site}' if site else ''}")
    table = pd.concat(parts, ignore_index=True)
    recordings = []
    for period in clocks.periods():
        rows = _framed(table[table["clock"] == period.clock], clocks, period)
        rows = on_site(rows, period.site, str(path))
        x, y = period.site.map_from_global(rows["global_x"].to_numpy(), rows["global_y"].to_numpy())
        recordings.append(rows.assign(recording=period.name, x=x, y=y))
    return pd.concat(recordings).sort_index(ignore_index=True).drop(columns=["clock", "site"])


def load(path: Path, crop: Crop | None = None) -> Recording:
    """Returns the only recording of an official file, cleaned.

    Args:
        path: official file.
        crop: the [low, high] to keep, by column under the names of ``formats.NAMES``.

    Raises:
        InputError: a line cannot be used, or the file holds several recordings.
    """
    clocks, parts = Clocks(), []
    for rows in blocks(path, [*ngsim_tracks.NEEDED, *(crop or {})]):
        clocks.assign(rows, str(path))
        parts.append(rows)
        if len(periods := clocks.periods()) > 1:
            raise InputError(
                f"{path}: holds several recordings ({', '.join(period.name for period in periods)} and maybe more): "
                f"convert it first, data convert {path.name} FOLDER"
            )
    if not parts:
        raise InputError(f"{path}: holds no rows")
    raw = _framed(pd.concat(parts, ignore_index=True), clocks, clocks.periods()[0])
    return _recording(raw, clocks.periods()[0], path, cleaned=True, crop=crop)[0]


def convert(source: Path, out: Path, *, cleaned: bool = True, crop: Crop | None = None) -> list[Converted]:
    """Converts an official file, with bars on a terminal.

    Args:
        source: official file.
        out: a folder, or a file if the name ends with .parquet and the source holds one recording; with several, the
            folder of that name without its suffix. A folder gets one file per recording.
        cleaned: whether headings, speeds and accelerations are derived from smoothed positions, or kept as published.
        crop: the [low, high] to keep, by column under the names of ``formats.NAMES``.

    Raises:
        InputError: a line cannot be used, some recordings cannot be made (the others have been), or `out` cannot be
            written.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            clocks = _sort_by_clock(source, Path(folder), [*ngsim_tracks.NEEDED, *(crop or {})])
            return _make_all(source, out, Path(folder), clocks, cleaned=cleaned, crop=crop)
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be written or read: {error.strerror or error}") from error


def _sort_by_clock(source: Path, folder: Path, wanted: Sequence[str]) -> Clocks:
    """Writes the rows of each clock to a Parquet file in `folder`, named by the clock's index.

    Raises:
        InputError: a line cannot be used, or there are no rows.
    """
    clocks, writers = Clocks(), dict[int, pq.ParquetWriter]()
    with ExitStack() as opened:
        for rows in blocks(source, wanted):
            index = clocks.assign(rows, str(source))
            for clock in np.unique(index).tolist():
                table = pa.Table.from_pandas(rows[index == clock].drop(columns="site"), preserve_index=False)
                if clock not in writers:
                    writer = pq.ParquetWriter(folder / f"{clock}.parquet", table.schema, compression="zstd")
                    writers[clock] = opened.enter_context(writer)
                writers[clock].write_table(table)
    if not writers:
        raise InputError(f"{source}: holds no rows")
    return clocks


def _make_all(
    source: Path, out: Path, folder: Path, clocks: Clocks, *, cleaned: bool, crop: Crop | None
) -> list[Converted]:
    """Makes the recordings of a file whose rows :func:`_sort_by_clock` has written to `folder`.

    Raises:
        InputError: some recordings cannot be made; the others have been.
    """
    periods = clocks.periods()
    single = out.suffix == ".parquet" and len(periods) == 1
    converted, refused = [], []
    for period in tqdm(periods, unit=" recordings", leave=False, disable=None):
        path = out if single else (out.with_suffix("") if out.suffix == ".parquet" else out) / f"{period.name}.parquet"
        raw = pq.read_table(folder / f"{period.clock}.parquet").to_pandas(split_blocks=True, self_destruct=True)
        try:
            recording, mended, cleaning = _recording(
                _framed(raw, clocks, period), period, source, cleaned=cleaned, crop=crop
            )
            recording.write(path)
        except Unwritable:
            raise
        except InputError as error:
            refused.append(f"{period.name}: {error}")
            continue
        vehicles = int(recording.table["vehicle_id"].nunique())
        report = cleaning.table() if cleaning else ""
        converted.append(Converted(path, period.name, len(recording.table), vehicles, mended, report))
    if refused:
        others = f"; made are {', '.join(one.name for one in converted)}" if converted else ""
        raise InputError("; ".join(refused) + others)
    return converted


def _framed(rows: pd.DataFrame, clocks: Clocks, period: Period) -> pd.DataFrame:
    """Returns the rows of a clock that are of `period`, with frame numbers of the clock."""
    rows = rows[period.holds(rows["time_ms"].to_numpy())]
    since_origin = rows["time_ms"].to_numpy() - clocks.clocks[period.clock].origin_ms
    return rows.assign(frame=np.round(since_origin / (1000.0 * STEP_S)).astype(np.int64))


def _recording(
    raw: pd.DataFrame, period: Period, source: Path, *, cleaned: bool, crop: Crop | None
) -> tuple[Recording, RepairCounts, CleaningReport | None]:
    """Returns one recording, the counts of its repairs, and the report on its cleaning (None if it was not cleaned).

    `raw` are the rows of the period in SI units: columns ``tracks.NEEDED``, those of the crop, and `line`.

    Raises:
        InputError: the crop keeps nothing, or no recording can be made of the rows.
    """
    raw = cropped(raw, crop, str(source))
    raw = raw.drop(columns=[name for name in raw if name not in (*ngsim_tracks.NEEDED, "line")])
    tracks, mended = ngsim_tracks.tracks_of(raw, period.site, str(source))
    table, report = ngsim_tracks.neutral(tracks, cleaned=cleaned)
    header = RecordingHeader(
        name=period.name,
        source=f"NGSIM {period.site.title}, period {period.name.partition('_')[2]} ({PUBLISHER})",
        licence=LICENCE,
        net=period.site.net,
        notes={
            "file": source.name,
            "cleaned": cleaned,
            "crop": {name: [float(value) for value in limits] for name, limits in (crop or {}).items()},
            "mended": {name: count for name, count in asdict(mended).items() if count},
        },
    )
    return Recording.from_table(header, table, str(source)), mended, report
