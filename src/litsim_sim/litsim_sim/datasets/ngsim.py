"""Official NGSIM files, as they are published, to recordings.

One file may hold several recordings (the portal's holds all sites and periods), so a conversion goes over the file
once, in blocks, and lays its rows aside by recording; then every recording is made for itself. Memory is bounded by a
block and by the largest recording. Both steps can be interrupted: what is done is kept beside the result, in a folder
``<OUT>.partial``, until everything is done.

Formats: :mod:`litsim_sim.datasets.ngsim_format`. Frames and sites: :mod:`litsim_sim.datasets.sites`. What is mended:
:mod:`litsim_sim.datasets.ngsim_tracks`. Accelerations and headings: :mod:`litsim_sim.datasets.cleaning`.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from tqdm import tqdm

from litsim_sim.datasets import ngsim_format, ngsim_tracks
from litsim_sim.datasets.cleaning import CleaningReport
from litsim_sim.datasets.cropping import Crop, cropped
from litsim_sim.datasets.ngsim_format import BlockReader, Layout
from litsim_sim.datasets.ngsim_periods import Clocks, Period
from litsim_sim.datasets.ngsim_tracks import Mended
from litsim_sim.datasets.sites import SITES
from litsim_sim.errors import InputError
from litsim_sim.files import Unwritable, replacing
from litsim_sim.recording import HEADER_KEY, Recording, RecordingHeader

LICENCE = "CC BY-SA"
PUBLISHER = "US DOT / FHWA, doi 10.21949/1504477"
CONVERSION = 1  # goes up whenever the same file would give other recordings
REPORT_FILE = "conversion.json"
STATE_FILE = "state.json"
LAID_ASIDE = 1_000_000  # rows after which what was read is written and the state is saved


@dataclass(frozen=True)
class Converted:
    """One recording that a conversion has made.

    Attributes:
        path: where it is.
        rows, vehicles: what it holds.
        mended: what was wrong in the file.
        cleaning: figures before and after, as text; empty if it was not cleaned.
    """

    path: Path
    name: str
    rows: int
    vehicles: int
    mended: Mended
    cleaning: str

    def text(self) -> str:
        """A line for people."""
        mended = self.mended.text()
        return f"{self.name}: {self.rows} rows, {self.vehicles} vehicles -> {self.path} ({mended})"


def read(
    path: Path,
    *,
    site: str | None = None,
    period: str | None = None,
    columns: Sequence[str] | None = None,
    truncated: bool = False,
    progress: bool = False,
) -> pd.DataFrame:
    """The rows of an official file with all their columns, in SI units, neither mended nor cleaned: for fitting maps.

    Args:
        path: official file.
        site: name of ``SITES`` to which to keep; all if not given. The portal's whole file takes 3 GB otherwise.
        period: such as "0750"; all if not given.
        columns: of ``ngsim_format.NAMES`` that are needed; all if not given.
        truncated: whether a last line that is cut off is left out instead of refused.
        progress: show a bar on stderr.

    Returns:
        in the order of the file: the columns (metres, seconds; `global_x`, `global_y` in metres of the State Plane;
        whole numbers with -1 for unknown), and `recording` (such as us101_0750), `x`, `y` (FRONT centre, frame map
        [m]), `line`. `frame` counts from the same instant within a recording.

    Raises:
        InputError: it is no official file, a line of it cannot be used, or nothing of it is of that site and period.
    """
    if site is not None and site not in SITES:
        raise InputError(f"site {site!r} is unknown, expected one of {', '.join(SITES)}")
    layout = layout_of(path)
    wanted = columns if columns is not None else list(ngsim_format.NAMES)
    names = list(SITES)
    kept: list[pd.DataFrame] = []
    clocks = Clocks()
    for block in blocks_of(path, layout, ["vehicle_id", "frame", *wanted], truncated=truncated, progress=progress):
        if site is not None:
            here = block["site"] == names.index(site)
            block = {name: values[here] for name, values in block.items()}  # noqa: PLW2901
        block["clock"] = clocks.assign(block, str(path))
        kept.append(pd.DataFrame(block))
    table = pd.concat(kept, ignore_index=True) if kept else pd.DataFrame()
    parts = []
    for found in clocks.periods():
        if period is None or found.name.partition("_")[2] == period:
            mine = (table["clock"] == found.clock).to_numpy() & found.holds(table["time_ms"].to_numpy())
            parts.append(_placed(table[mine], found, clocks))
    if not parts:
        held = ", ".join(found.name for found in clocks.periods())
        raise InputError(f"{path}: holds nothing of site {site}, period {period}; it holds {held or 'no rows'}")
    return pd.concat(parts).sort_index(ignore_index=True).drop(columns=["clock", "site"])


def _placed(table: pd.DataFrame, period: Period, clocks: Clocks) -> pd.DataFrame:
    """Rows of one period with positions in frame map and frames of its clock."""
    x, y = period.site.map_from_global(table["global_x"].to_numpy(), table["global_y"].to_numpy())
    frame = ngsim_tracks.frames_of(table["time_ms"].to_numpy(), clocks.clocks[period.clock].origin_ms)
    return table.assign(frame=frame, recording=period.name, x=x, y=y)


def load(path: Path, crop: Crop | None = None) -> Recording:
    """The one recording that an official file holds, cleaned, in memory.

    Args:
        path: official file.
        crop: by column as :func:`read` names them, the [low, high] to keep.

    Raises:
        InputError: a line of it cannot be used, or it holds several recordings.
    """
    layout = layout_of(path)
    clocks = Clocks()
    kept = []
    for block in blocks_of(path, layout, [*ngsim_tracks.NEEDED, *(crop or {})]):
        block["clock"] = clocks.assign(block, str(path))
        kept.append(pd.DataFrame(block))
        if len(periods := clocks.periods()) > 1:
            raise InputError(
                f"{path}: holds several recordings ({', '.join(period.name for period in periods)} and maybe more): "
                f"convert it first, data convert {path.name} FOLDER"
            )
    if not clocks.clocks:
        raise InputError(f"{path}: holds no rows")
    raw = pd.concat(kept, ignore_index=True)
    recording, _, _ = _recording(raw, clocks, clocks.periods()[0], path, _Options(cleaned=True, crop=crop))
    return recording


@dataclass(frozen=True)
class _Options:
    """What else than the file decides what comes out."""

    cleaned: bool = True
    truncated: bool = False
    crop: Crop | None = None

    def key(self) -> dict[str, Any]:
        crop = {name: [float(value) for value in limits] for name, limits in (self.crop or {}).items()}
        return {"conversion": CONVERSION, "cleaned": self.cleaned, "truncated": self.truncated, "crop": crop}


def convert(
    source: Path,
    out: Path,
    *,
    cleaned: bool = True,
    truncated: bool = False,
    crop: Crop | None = None,
    progress: bool = False,
) -> list[Converted]:
    """Convert an official file; what an earlier, interrupted call has done is taken up, what is complete is left.

    Args:
        source: official file.
        out: where it goes. A name that ends with .parquet is one file if the source holds one recording, and else the
            folder of that name without its ending; any other name is a folder. In a folder every recording has a file
            of its own, and ``conversion.json`` says what was found.
        cleaned: whether headings, speeds and accelerations are derived from smoothed positions, or stay as published.
        truncated: whether a last line that is cut off is left out instead of refused.
        crop: by column as :func:`read` names them, the [low, high] to keep.
        progress: show bars on stderr.

    Returns:
        the recordings, also those that were complete before; `mended` and `cleaning` are those of their conversion.

    Raises:
        InputError: a line of the file cannot be used, no recording can be made of its rows, or `out` cannot be written.
    """
    layout = layout_of(source)
    options = _Options(cleaned, truncated, crop)
    try:
        done = _complete(source, out, options)
        if done is not None:
            return done
        work = _Work(source, out, options)
        try:
            work.lay_aside(layout, progress=progress)
            return work.make(progress=progress)
        except Unwritable:
            raise  # what is laid aside is taken up by the next call
        except InputError:
            work.discard()
            raise
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be written or read: {error.strerror or error}") from error


class _Work:
    """An unfinished conversion: rows by clock in Parquet files, and how far it has come."""

    def __init__(self, source: Path, out: Path, options: _Options) -> None:
        """Take up what is there if it is of the same file and options."""
        self.source, self.out, self.options = source, out, options
        self.folder = out.with_name(out.name + ".partial")
        self.offset, self.line, self.files, self.off_site, self.whole = -1, -1, 0, 0, False
        self.clocks = Clocks()
        self.done: dict[str, dict[str, Any]] = {}
        self._identity = {"source": _identity(source), **options.key()}
        state = _json(self.folder / STATE_FILE)
        if state is not None and state.get("identity") == self._identity:
            self.offset, self.line, self.files = state["offset"], state["line"], state["files"]
            self.off_site, self.whole, self.done = state["off_site"], state["whole"], state["done"]
            self.clocks = Clocks.from_json(state["clocks"])
            for part in self.folder.glob("*/*.parquet"):  # written after the state was saved: it will be read again
                if int(part.stem) >= self.files:
                    part.unlink()
        else:
            shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True, exist_ok=True)

    def discard(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)

    def save(self) -> None:
        names = ("offset", "line", "files", "off_site", "whole", "done")
        state = {name: getattr(self, name) for name in names}
        _write_json(self.folder / STATE_FILE, state | {"identity": self._identity, "clocks": self.clocks.to_json()})

    def lay_aside(self, layout: Layout, *, progress: bool) -> None:
        """Read the rest of the file."""
        if self.whole:
            return
        waiting: list[dict[str, np.ndarray]] = []
        wanted = [*ngsim_tracks.NEEDED, *(self.options.crop or {})]
        reader = BlockReader(self.source, layout, wanted, truncated=self.options.truncated)
        begin = layout.start if self.offset < 0 else self.offset
        line = layout.line if self.offset < 0 else self.line
        bar = _bar(self.source, begin, progress=progress)
        with bar:
            for block in reader.blocks(begin, line):
                columns = dict(block.columns)
                if len(columns["line"]):
                    columns["clock"] = self.clocks.assign(columns, str(self.source))
                    waiting.append(columns)
                self.offset, self.line, self.off_site = block.end, block.end_line, self.off_site + block.off_site
                bar.update(block.end - bar.n)
                if sum(len(columns["line"]) for columns in waiting) >= LAID_ASIDE:
                    self._write_aside(waiting)
                    waiting = []
        self.whole = True
        self._write_aside(waiting)
        if not self.clocks.clocks:
            raise InputError(f"{self.source}: holds no rows")

    def _write_aside(self, blocks: list[dict[str, np.ndarray]]) -> None:
        if blocks:
            columns = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
            clock = columns.pop("clock")
            del columns["site"]
            for code in np.unique(clock):
                mine = clock == code
                table = pa.table({name: values[mine] for name, values in columns.items()})
                path = self.folder / self.clocks.clocks[code].key / f"{self.files:05}.parquet"
                path.parent.mkdir(exist_ok=True)
                pq.write_table(table, path, compression="zstd", compression_level=1)
            self.files += 1
        self.save()  # files that are written but not in a saved state are written again

    def make(self, *, progress: bool) -> list[Converted]:
        """Make what is not made yet, and finish."""
        periods = self.clocks.periods()
        single = self.out.suffix == ".parquet" and len(periods) == 1
        folder = self.out.with_suffix("") if self.out.suffix == ".parquet" else self.out
        converted, refused = [], []
        for number, period in enumerate(periods, 1):
            path = self.out if single else folder / f"{period.name}.parquet"
            if period.name not in self.done or not path.is_file():
                if progress:
                    tqdm.write(f"{period.name} ({number} of {len(periods)})", file=sys.stderr)
                try:
                    self._make_one(period, path, progress=progress)
                except Unwritable:
                    raise
                except InputError as error:
                    refused.append(f"{period.name}: {error}")
                    continue
            converted.append(_from_report(self.done[period.name], path))
        if refused:
            others = f"; made are {', '.join(one.name for one in converted)}" if converted else ""
            raise InputError("; ".join(refused) + others)
        if not single:
            report = {"identity": self._identity, "off_site": self.off_site, "recordings": self.done}
            _write_json(folder / REPORT_FILE, report)
        self.discard()
        return converted

    def _make_one(self, period: Period, path: Path, *, progress: bool) -> None:
        parts = sorted((self.folder / self.clocks.clocks[period.clock].key).glob("*.parquet"))
        raw = pa.concat_tables([pq.read_table(part) for part in parts]).to_pandas(split_blocks=True, self_destruct=True)
        recording, mended, cleaning = _recording(raw, self.clocks, period, self.source, self.options, progress=progress)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as new:
            recording.write(new)
        self.done[period.name] = {
            "name": period.name,
            "rows": len(recording.table),
            "vehicles": int(recording.table["vehicle_id"].nunique()),
            "mended": asdict(mended),
            "cleaning": cleaning.table() if cleaning else "",
        }
        self.save()


def _recording(
    raw: pd.DataFrame, clocks: Clocks, period: Period, source: Path, options: _Options, *, progress: bool = False
) -> tuple[Recording, Mended, CleaningReport | None]:
    """One recording from the rows of its clock."""
    raw = raw[period.holds(raw["time_ms"].to_numpy())]
    raw = raw.assign(frame=ngsim_tracks.frames_of(raw["time_ms"].to_numpy(), clocks.clocks[period.clock].origin_ms))
    raw = cropped(raw, options.crop, str(source))
    raw = raw.drop(columns=[name for name in raw if name not in (*ngsim_tracks.NEEDED, "line")])
    tracks, mended = ngsim_tracks.tracks_of(raw, period.site, str(source))
    del raw
    table, report = ngsim_tracks.neutral(tracks, cleaned=options.cleaned, progress=progress)
    notes: dict[str, object] = {"file": source.name, "bytes": source.stat().st_size, **options.key()}
    notes["mended"] = {name: count for name, count in asdict(mended).items() if count}
    header = RecordingHeader(
        name=period.name,
        source=f"NGSIM {period.site.title}, period {period.name.partition('_')[2]} ({PUBLISHER})",
        licence=LICENCE,
        net=period.site.net,
        notes=notes,
    )
    return Recording.from_table(header, table, str(source)), mended, report


def _complete(source: Path, out: Path, options: _Options) -> list[Converted] | None:
    """What an earlier conversion of the same file has made, if it is all there."""
    folder = out.with_suffix("") if out.suffix == ".parquet" else out
    report = _json(folder / REPORT_FILE)
    if report is not None and report.get("identity") == {"source": _identity(source), **options.key()}:
        made = [_from_report(values, folder / f"{name}.parquet") for name, values in report["recordings"].items()]
        if made and all(converted.path.is_file() for converted in made):
            return made
    if out.suffix == ".parquet" and out.is_file() and out.stat().st_mtime_ns >= source.stat().st_mtime_ns:
        notes = _notes(out)
        if notes and {"file": source.name, "bytes": source.stat().st_size, **options.key()}.items() <= notes.items():
            table = pq.read_table(out, columns=["vehicle_id"])
            vehicles = table.column("vehicle_id").unique()
            mended = Mended(**notes["mended"])
            name = json.loads(pq.read_schema(out).metadata[HEADER_KEY])["name"]
            return [Converted(out, name, len(table), len(vehicles), mended, "")]
    return None


def _notes(path: Path) -> dict[str, Any]:
    """Notes in the header of a recording; none if it has none."""
    try:
        raw = (pq.read_schema(path).metadata or {}).get(HEADER_KEY, b"{}")
        notes = json.loads(raw).get("notes", {})
    except (pa.ArrowException, ValueError):
        return {}
    return notes if isinstance(notes, dict) else {}


def _from_report(values: dict[str, Any], path: Path) -> Converted:
    return Converted(path, **{**values, "mended": Mended(**values["mended"])})


def layout_of(path: Path) -> Layout:
    """How the official file at `path` is laid out.

    Raises:
        InputError: it is missing, cannot be read, or is no official file.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such recording")
    layout = ngsim_format.detect(path)
    if layout is None:
        raise InputError(f"{path}: no official NGSIM file")
    return layout


def blocks_of(
    path: Path, layout: Layout, wanted: Sequence[str], *, truncated: bool = False, progress: bool = False
) -> Iterable[dict[str, np.ndarray]]:
    """Columns of every block of the file that has rows, with a bar; as :class:`litsim_sim.datasets.ngsim_format.Block`.

    Raises:
        InputError: a line cannot be used.
    """
    with _bar(path, layout.start, progress=progress) as bar:
        for block in BlockReader(path, layout, wanted, truncated=truncated).blocks():
            bar.update(block.end - bar.n)
            if len(block.columns["line"]):
                yield dict(block.columns)


def _bar(path: Path, begin: int, *, progress: bool) -> tqdm[Any]:
    size = path.stat().st_size
    return tqdm(total=size, initial=begin, unit="B", unit_scale=True, desc=path.name, disable=not progress)


def _identity(path: Path) -> dict[str, Any]:
    status = path.stat()
    return {"name": path.name, "bytes": status.st_size, "mtime_ns": status.st_mtime_ns}


def _json(path: Path) -> dict[str, Any] | None:
    """What is in the file, or None if there is none or it is not whole."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return values if isinstance(values, dict) else None


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with replacing(path) as new:
        new.write_text(json.dumps(values, indent=1), encoding="utf-8")
