"""Conversion of an official NGSIM file: rows are spooled to disk by clock, then recordings are made of them."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from tqdm import tqdm

from litsim_data.cleaning.cleaning import CleaningReport
from litsim_data.ngsim import tracks as ngsim_tracks
from litsim_data.ngsim.blocks import BlockReader
from litsim_data.ngsim.formats import Layout
from litsim_data.ngsim.periods import Clocks, Period
from litsim_data.ngsim.tracks import RepairCounts
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import Unwritable, replacing
from litsim_sim.io.parquet_input import UNREADABLE
from litsim_sim.scenario.cropping import Crop, cropped
from litsim_sim.scenario.recording import HEADER_KEY, Recording, RecordingHeader

LICENCE = "CC BY-SA"
PUBLISHER = "US DOT / FHWA, doi 10.21949/1504477"
CONVERSION = 1  # goes up whenever the same file would give other recordings
REPORT_FILE = "conversion.json"
STATE_FILE = "state.json"
SPOOLED = 1_000_000  # rows after which a part is written and the state is saved


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
        """The recording, its file and the repairs, as one line of text."""
        mended = self.mended.text()
        return f"{self.name}: {self.rows} rows, {self.vehicles} vehicles -> {self.path} ({mended})"


@dataclass(frozen=True)
class Options:
    """Options of a conversion; fields as the arguments of ``ngsim.convert``."""

    cleaned: bool = True
    truncated: bool = False
    crop: Crop | None = None

    def key(self) -> dict[str, Any]:
        """The options as JSON: results of equal keys, from the same file, are equal."""
        crop = {name: [float(value) for value in limits] for name, limits in (self.crop or {}).items()}
        return {"conversion": CONVERSION, "cleaned": self.cleaned, "truncated": self.truncated, "crop": crop}


class Work:
    """An unfinished conversion: rows by clock in Parquet files, and its progress."""

    def __init__(self, source: Path, out: Path, options: Options) -> None:
        """Resume an earlier conversion of the same file with the same options, if there is one."""
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
            for part in self.folder.glob("*/*.parquet"):  # newer than the saved state: will be read again
                if int(part.stem) >= self.files:
                    part.unlink()
        else:
            shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True, exist_ok=True)

    def discard(self) -> None:
        """Delete the folder of the unfinished conversion with everything in it."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def save(self) -> None:
        """Save the progress, so that a later conversion can resume from there."""
        names = ("offset", "line", "files", "off_site", "whole", "done")
        state = {name: getattr(self, name) for name in names}
        _write_json(self.folder / STATE_FILE, state | {"identity": self._identity, "clocks": self.clocks.to_json()})

    def spool(self, layout: Layout, *, progress: bool) -> None:
        """Read the rest of the source, and write its rows by clock to Parquet files.

        Raises:
            InputError: a line cannot be used, or there are no rows.
        """
        if self.whole:
            return
        waiting: list[dict[str, np.ndarray]] = []
        wanted = [*ngsim_tracks.NEEDED, *(self.options.crop or {})]
        reader = BlockReader(self.source, layout, wanted, truncated=self.options.truncated)
        begin = layout.start if self.offset < 0 else self.offset
        line = layout.line if self.offset < 0 else self.line
        bar = bar_over(self.source, begin, progress=progress)
        with bar:
            for block in reader.blocks(begin, line):
                columns = dict(block.columns)
                if len(columns["line"]):
                    columns["clock"] = self.clocks.assign(columns, str(self.source))
                    waiting.append(columns)
                self.offset, self.line, self.off_site = block.end, block.end_line, self.off_site + block.off_site
                bar.update(block.end - bar.n)
                if sum(len(columns["line"]) for columns in waiting) >= SPOOLED:
                    self._spool_part(waiting)
                    waiting = []
        self.whole = True
        self._spool_part(waiting)
        if not self.clocks.clocks:
            raise InputError(f"{self.source}: holds no rows")

    def _spool_part(self, blocks: list[dict[str, np.ndarray]]) -> None:
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
        self.save()  # files written after the last save are written again

    def make(self, *, progress: bool) -> list[Converted]:
        """Make the missing recordings, and move everything to its final name.

        Raises:
            InputError: some recordings cannot be made; the others have been.
            Unwritable: a file cannot be written.
        """
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
        recording, mended, cleaning = recording_of(
            raw, self.clocks, period, self.source, self.options, progress=progress
        )
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


def recording_of(
    raw: pd.DataFrame, clocks: Clocks, period: Period, source: Path, options: Options, *, progress: bool = False
) -> tuple[Recording, RepairCounts, CleaningReport | None]:
    """One recording, the counts of its repairs, and the report on its cleaning (None if it was not cleaned).

    Args:
        raw: rows of a clock in SI units: columns ``ngsim_tracks.NEEDED``, those of the crop, and `line`.
        clocks: clocks of the file.
        period: period of the recording; rows outside it are left out.
        source: the official file.
        options: options of the conversion.
        progress: show a bar on stderr.

    Raises:
        InputError: the crop keeps nothing, or no recording can be made of the rows.
    """
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


def complete(source: Path, out: Path, options: Options) -> list[Converted] | None:
    """The recordings of an earlier conversion with the same file and options; None unless all are there."""
    folder = out.with_suffix("") if out.suffix == ".parquet" else out
    report = _json(folder / REPORT_FILE)
    if report is not None and report.get("identity") == {"source": _identity(source), **options.key()}:
        made = [_from_report(values, folder / f"{name}.parquet") for name, values in report["recordings"].items()]
        if made and all(converted.path.is_file() for converted in made):
            return made
    if out.suffix == ".parquet" and out.is_file() and out.stat().st_mtime_ns >= source.stat().st_mtime_ns:
        notes = _notes(out)
        if notes and {"file": source.name, "bytes": source.stat().st_size, **options.key()}.items() <= notes.items():
            try:
                table = pq.read_table(out, columns=["vehicle_id"], page_checksum_verification=True)
            except UNREADABLE:  # will be made again
                return None
            vehicles = table.column("vehicle_id").unique()
            mended = RepairCounts(**notes["mended"])
            name = json.loads(table.schema.metadata[HEADER_KEY])["name"]
            return [Converted(out, name, len(table), len(vehicles), mended, "")]
    return None


def _notes(path: Path) -> dict[str, Any]:
    """Notes in the header of a recording; empty without a header."""
    try:
        raw = (pq.read_schema(path).metadata or {}).get(HEADER_KEY, b"{}")
        notes = json.loads(raw).get("notes", {})
    except (*UNREADABLE, ValueError):
        return {}
    return notes if isinstance(notes, dict) else {}


def _from_report(values: dict[str, Any], path: Path) -> Converted:
    return Converted(path, **{**values, "mended": RepairCounts(**values["mended"])})


def bar_over(path: Path, begin: int, *, progress: bool) -> tqdm[Any]:
    """A bar on stderr over the bytes of the file at `path` from `begin` on; none is shown without `progress`."""
    size = path.stat().st_size
    return tqdm(total=size, initial=begin, unit="B", unit_scale=True, desc=path.name, disable=not progress)


def _identity(path: Path) -> dict[str, Any]:
    status = path.stat()
    return {"name": path.name, "bytes": status.st_size, "mtime_ns": status.st_mtime_ns}


def _json(path: Path) -> dict[str, Any] | None:
    """The object in a JSON file; None if the file is missing or incomplete."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return values if isinstance(values, dict) else None


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with replacing(path) as new:
        new.write_text(json.dumps(values, indent=1), encoding="utf-8")
