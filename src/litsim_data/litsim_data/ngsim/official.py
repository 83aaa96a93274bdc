"""Conversion of official NGSIM files, as published, in bounded memory.

A file may hold several recordings (the portal's holds all sites and periods). A conversion reads the file once, block
by block, and keeps its rows by clock in a temporary folder beside the result; then each recording is converted like any
other table, by a mapping. Memory is bounded by a block and by the largest recording.

Layouts: :mod:`.formats`, read by :mod:`.reading`. Sites and frames: :mod:`.sites`. Recordings of a file:
:mod:`.periods`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from tqdm import tqdm

from litsim_data.generic.convert import convert as convert_table
from litsim_data.generic.counts import Counts
from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.generic.mapping import Check
from litsim_data.ngsim.periods import Clocks, Period
from litsim_data.ngsim.reading import blocks, on_site
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.files import Unwritable
from litsim_sim.scenario.cropping import Crop, cropped
from litsim_sim.scenario.recording import BOUNDS, Recording

LICENCE = "CC BY-SA"
PUBLISHER = "US DOT / FHWA, doi 10.21949/1504477"
NEEDED = (
    *("vehicle_id", "frame", "time_ms", "global_x", "global_y", "length", "width"),
    *("vehicle_class", "speed", "acceleration", "lane"),
)
"""Columns of the file that a conversion needs."""
KINDS = {"1": "motorcycle", "2": "car", "3": "truck"}
"""Our kinds by v_Class."""
USUAL_SIZE = {1: (2.2, 0.9), 2: (4.6, 2.0), 3: (12.0, 2.5)}
"""Length and width [m] by v_Class, of vehicles whose size in the file is implausible."""
CONTRADICTIONS_MAX = 0.01  # share of contradicting rows above which a recording is refused


@dataclass(frozen=True)
class Converted:
    """One recording made by a conversion: its file, its name, its number of vehicles, and counts of the conversion."""

    path: Path
    name: str
    vehicles: int
    counts: Counts


class _Lines(LoadedTable):
    """The rows of one recording, whose column `line` says where they are in the file."""

    def at(self, *rows: int) -> str:
        """See :class:`LoadedTable`; rows are lines of the file."""
        return f"{self.path}: line{'s' if len(rows) > 1 else ''} {' and '.join(map(str, rows))}"

    def read(self, wanted: list[str], *, needed: set[str] | None = None, whose: str = "") -> pd.DataFrame:  # noqa: ARG002 - all are there
        """See :class:`LoadedTable`."""
        return self.table[wanted].assign(row=self.table["line"])


def load(path: Path, crop: Crop | None = None) -> Recording:
    """Returns the only recording of an official file, cleaned.

    Args:
        path: official file.
        crop: the [low, high] to keep, by column under the names of ``formats.NAMES``.

    Raises:
        InputError: a line cannot be used, or the file holds several recordings.
    """
    clocks, parts = Clocks(), []
    for rows in blocks(path, [*NEEDED, *(crop or {})]):
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
            clocks = _sort_by_clock(source, Path(folder), [*NEEDED, *(crop or {})])
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
            framed = _framed(raw, clocks, period)
            recording, counts = _recording(framed, period, source, cleaned=cleaned, crop=crop)
            recording.write(path)
        except Unwritable:
            raise
        except InputError as error:
            refused.append(f"{period.name}: {error}")
            continue
        vehicles = len(np.unique(recording.columns["vehicle_id"]))
        converted.append(Converted(path, period.name, vehicles, counts))
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
) -> tuple[Recording, Counts]:
    """Returns one recording, and counts of its conversion.

    `raw` are the rows of the period in SI units: columns NEEDED, those of the crop, and `line`.

    Raises:
        InputError: the crop keeps nothing, or no recording can be made of the rows.
    """
    rows = on_site(raw, period.site, str(source))
    x, y = period.site.map_from_global(rows["global_x"].to_numpy(), rows["global_y"].to_numpy())
    rows = cropped(rows.assign(x=x, y=y), crop, str(source))
    single = _without_contradictions(rows, source)
    kind, lane = single["vehicle_class"].astype(str), single["lane"]
    lane = lane.where((lane >= 1) & (lane <= BOUNDS["lane"][1]), -1)
    table = single[["vehicle_id", "frame", "x", "y", "speed", "acceleration", "line"]]
    table = table.assign(kind=kind, lane=lane, **_sizes(single))
    tracks = _Lines((), tuple(map(str, table.columns)), source, table)
    mapping = tracks.meaning(
        {name: KINDS.get(name, "unknown") for name in kind.unique()},
        name=period.name,
        source=f"NGSIM {period.site.title}, period {period.name.partition('_')[2]} ({PUBLISHER})",
        licence=LICENCE,
        net=period.site.net,
        reference="front_centre",
        clean=cleaned,
        accept=get_args(Check),  # what is published is what it is
    )
    recording, counts = convert_table(tracks, mapping)
    counts.read = len(raw)
    counts.leave_out("off the site", len(raw) - len(rows))
    counts.leave_out("the vehicle is elsewhere at the same time", len(rows) - len(single))
    notes = recording.header.notes | counts.note()
    notes |= {"cleaned": True} if cleaned else {}
    notes |= {"crop": {name: [float(value) for value in limits] for name, limits in (crop or {}).items()}}
    return Recording(replace(recording.header, notes=notes), recording.columns), counts


def _without_contradictions(rows: pd.DataFrame, source: Path) -> pd.DataFrame:
    """Returns the rows without those that put a vehicle elsewhere than another one of the same time does.

    Raises:
        InputError: they are more than CONTRADICTIONS_MAX of all.
    """
    of_one_time = ["vehicle_id", "frame"]
    places = rows.drop_duplicates([*of_one_time, "x", "y"])
    twice = places[places.duplicated(of_one_time, keep=False)]
    if twice.empty:
        return rows
    if len(twice) > CONTRADICTIONS_MAX * len(rows):
        first, other = (one for _, one in twice.sort_values([*of_one_time, "line"]).iloc[:2].iterrows())
        raise InputError(
            f"{source}: lines {first['line']:.0f} and {other['line']:.0f}: Vehicle_ID {first['vehicle_id']:.0f} is at "
            f"two places at frame {first['frame']:.0f}; {len(twice)} of {len(rows)} rows contradict each other"
        )
    contradicted = pd.MultiIndex.from_frame(twice[of_one_time])
    return rows[~pd.MultiIndex.from_frame(rows[of_one_time]).isin(contradicted)]


def _sizes(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Returns length and width [m] of each row's vehicle: its median, or the usual one of its class."""
    usual = rows["vehicle_class"].map(lambda number: USUAL_SIZE.get(number, USUAL_SIZE[2]))
    sizes = {}
    for name, of_class in zip(("length", "width"), zip(*usual, strict=True), strict=True):
        median = rows.groupby("vehicle_id")[name].transform("median")
        sizes[name] = median.where(median.between(*BOUNDS[name]), pd.Series(of_class, index=rows.index))
    return sizes
