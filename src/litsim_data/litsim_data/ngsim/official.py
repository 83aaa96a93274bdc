"""Reading and conversion of official NGSIM files, as published, in bounded memory.

A file may hold several recordings (the portal's holds all sites and periods). A conversion reads the file once, block
by block, and keeps its rows by clock in a temporary folder beside the result; then the recordings are made one by one.
Memory is bounded by a block and by the largest recording.

Layouts: :mod:`.formats`, read by :mod:`.reading`. Sites and frames: :mod:`.sites`. Recordings of a file:
:mod:`.periods`. Repairs: :mod:`.tracks`.
"""

from __future__ import annotations

import sys
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
from litsim_data.ngsim.formats import NAMES
from litsim_data.ngsim.periods import Clocks, Period
from litsim_data.ngsim.reading import blocks, on_site
from litsim_data.ngsim.sites import SITES
from litsim_data.ngsim.tracks import RepairCounts
from litsim_sim.core.errors import InputError
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

    def text(self) -> str:
        """Returns the recording, its file and the repairs, as one line of text."""
        return f"{self.name}: {self.rows} rows, {self.vehicles} vehicles -> {self.path} ({self.mended.text()})"


def read(
    path: Path,
    *,
    site: str | None = None,
    period: str | None = None,
    columns: Sequence[str] | None = None,
    progress: bool = False,
) -> pd.DataFrame:
    """Returns the rows of an official file in SI units, neither repaired nor cleaned, for fitting maps.

    Args:
        path: official file.
        site: key of ``SITES`` to keep; default: all, which takes 3 GB of memory for the portal's file.
        period: period to keep, such as "0750"; default: all.
        columns: names in ``formats.NAMES`` to read; default: all.
        progress: show a bar on stderr.

    Returns:
        In the order of the file: the columns (metres, seconds; `global_x`, `global_y` in metres of the State Plane;
        -1 for unknown integers), and `recording` (such as us101_0750), `x`, `y` (FRONT centre, frame map [m]), `line`.
        `frame` counts from the same instant within a recording.

    Raises:
        InputError: it is not an official file, a line cannot be used, or no row is of that site and period.
    """
    if site is not None and site not in SITES:
        raise InputError(f"site {site!r} is unknown, expected one of {', '.join(SITES)}")
    wanted = columns if columns is not None else list(NAMES)
    kept, clocks = [], Clocks()
    for rows in blocks(path, ["vehicle_id", "frame", *wanted], progress=progress):
        here = rows if site is None else rows[rows["site"] == list(SITES).index(site)]
        kept.append(here.assign(clock=clocks.assign(here, str(path))))
    periods = clocks.periods()
    chosen = [one for one in periods if period is None or one.name.partition("_")[2] == period]
    if not chosen:
        held = ", ".join(one.name for one in periods)
        raise InputError(f"{path}: holds nothing of site {site}, period {period}; it holds {held or 'no rows'}")
    table = pd.concat(kept, ignore_index=True)
    parts = [_placed(table[table["clock"] == one.clock], one, clocks, str(path)) for one in chosen]
    return pd.concat(parts).sort_index(ignore_index=True).drop(columns=["clock", "site"])


def _placed(table: pd.DataFrame, period: Period, clocks: Clocks, where: str) -> pd.DataFrame:
    """Returns the rows of one period of a clock with positions in frame map and frame numbers of the clock."""
    table = on_site(table[period.holds(table["time_ms"].to_numpy())], period.site, where)
    x, y = period.site.map_from_global(table["global_x"].to_numpy(), table["global_y"].to_numpy())
    frame = ngsim_tracks.frames_of(table["time_ms"].to_numpy(), clocks.clocks[period.clock].origin_ms)
    return table.assign(frame=frame, recording=period.name, x=x, y=y)


def load(path: Path, crop: Crop | None = None) -> Recording:
    """Returns the only recording of an official file, cleaned.

    Args:
        path: official file.
        crop: the [low, high] to keep, by column under the names of :func:`read`.

    Raises:
        InputError: a line cannot be used, or the file holds several recordings.
    """
    clocks, kept = Clocks(), []
    for rows in blocks(path, [*ngsim_tracks.NEEDED, *(crop or {})]):
        clocks.assign(rows, str(path))
        kept.append(rows)
        if len(periods := clocks.periods()) > 1:
            raise InputError(
                f"{path}: holds several recordings ({', '.join(period.name for period in periods)} and maybe more): "
                f"convert it first, data convert {path.name} FOLDER"
            )
    if not kept:
        raise InputError(f"{path}: holds no rows")
    raw = pd.concat(kept, ignore_index=True)
    recording, _, _ = _recording(raw, clocks, clocks.periods()[0], path, cleaned=True, crop=crop)
    return recording


def convert(
    source: Path, out: Path, *, cleaned: bool = True, crop: Crop | None = None, progress: bool = False
) -> list[Converted]:
    """Converts an official file.

    Args:
        source: official file.
        out: a folder, or a file if the name ends with .parquet and the source holds one recording; with several, the
            folder of that name without its suffix. A folder gets one file per recording.
        cleaned: whether headings, speeds and accelerations are derived from smoothed positions, or kept as published.
        crop: the [low, high] to keep, by column under the names of :func:`read`.
        progress: show bars on stderr.

    Raises:
        InputError: a line cannot be used, some recordings cannot be made (the others have been), or `out` cannot be
            written.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            clocks = _sort_by_clock(source, Path(folder), [*ngsim_tracks.NEEDED, *(crop or {})], progress=progress)
            return _make_all(source, out, Path(folder), clocks, cleaned=cleaned, crop=crop, progress=progress)
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be written or read: {error.strerror or error}") from error


def _sort_by_clock(source: Path, folder: Path, wanted: Sequence[str], *, progress: bool) -> Clocks:
    """Writes the rows of each clock to a Parquet file in `folder`, named by the clock's index.

    Raises:
        InputError: a line cannot be used, or there are no rows.
    """
    clocks, writers = Clocks(), dict[int, pq.ParquetWriter]()
    with ExitStack() as opened:
        for rows in blocks(source, wanted, progress=progress):
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
    source: Path, out: Path, folder: Path, clocks: Clocks, *, cleaned: bool, crop: Crop | None, progress: bool
) -> list[Converted]:
    """Makes the recordings of a file whose rows :func:`_sort_by_clock` has written to `folder`.

    Raises:
        InputError: some recordings cannot be made; the others have been.
    """
    periods = clocks.periods()
    single = out.suffix == ".parquet" and len(periods) == 1
    converted, refused = [], []
    for number, period in enumerate(periods, 1):
        path = out if single else (out.with_suffix("") if out.suffix == ".parquet" else out) / f"{period.name}.parquet"
        if progress:
            tqdm.write(f"{period.name} ({number} of {len(periods)})", file=sys.stderr)
        raw = pq.read_table(folder / f"{period.clock}.parquet").to_pandas(split_blocks=True, self_destruct=True)
        try:
            recording, mended, cleaning = _recording(
                raw, clocks, period, source, cleaned=cleaned, crop=crop, progress=progress
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


def _recording(
    raw: pd.DataFrame,
    clocks: Clocks,
    period: Period,
    source: Path,
    *,
    cleaned: bool,
    crop: Crop | None,
    progress: bool = False,
) -> tuple[Recording, RepairCounts, CleaningReport | None]:
    """Returns one recording, the counts of its repairs, and the report on its cleaning (None if it was not cleaned).

    Args:
        raw: rows of a clock in SI units: columns ``tracks.NEEDED``, those of the crop, and `line`.
        clocks: clocks of the file.
        period: period of the recording; rows outside it are left out.
        source: the official file.
        cleaned, crop, progress: as for :func:`convert`.

    Raises:
        InputError: the crop keeps nothing, or no recording can be made of the rows.
    """
    raw = raw[period.holds(raw["time_ms"].to_numpy())]
    raw = raw.assign(frame=ngsim_tracks.frames_of(raw["time_ms"].to_numpy(), clocks.clocks[period.clock].origin_ms))
    raw = cropped(raw, crop, str(source))
    raw = raw.drop(columns=[name for name in raw if name not in (*ngsim_tracks.NEEDED, "line")])
    tracks, mended = ngsim_tracks.tracks_of(raw, period.site, str(source))
    del raw
    table, report = ngsim_tracks.neutral(tracks, cleaned=cleaned, progress=progress)
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
