"""The files of NGSIM as they are published, read block by block: recognised by content, every defect with its line.

Two formats:

- text: numbers between blanks, no header, 18 columns (motorways) or 24 (streets: six more, see ``TEXT_COLUMNS``);
- CSV of the US DOT portal (25 columns, all sites in one file) or of its archives (18 columns), header in any order and
  spelling, numbers with or without thousands commas ("1,118,847,869,000").

Values leave this module in SI units: feet end here.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv

from litsim_sim.datasets.sites import FOOT, SITES, site_at, site_of
from litsim_sim.errors import InputError
from litsim_sim.scene import BoolArray, FloatArray, IntArray

BLOCK = 16 << 20  # [bytes] read at once
HEAD = 1 << 16  # [bytes] that recognition looks at

NAMES: dict[str, tuple[str, ...]] = {
    "vehicle_id": ("Vehicle_ID",),
    "frame": ("Frame_ID",),
    "total_frames": ("Total_Frames",),
    "time_ms": ("Global_Time",),
    "local_x": ("Local_X",),
    "local_y": ("Local_Y",),
    "global_x": ("Global_X",),
    "global_y": ("Global_Y",),
    "length": ("v_Length",),
    "width": ("v_Width",),
    "vehicle_class": ("v_Class",),
    "speed": ("v_Vel",),
    "acceleration": ("v_Acc",),
    "lane": ("Lane_ID",),
    "o_zone": ("O_Zone",),
    "d_zone": ("D_Zone",),
    "intersection": ("Int_ID",),
    "section": ("Section_ID",),
    "direction": ("Direction",),
    "movement": ("Movement",),
    "preceding": ("Preceding",),
    "following": ("Following",),
    "space_headway": ("Space_Headway", "Space_Hdwy", "Spacing"),
    "time_headway": ("Time_Headway", "Time_Hdwy", "Headway"),
    "location": ("Location",),
}
"""Our names of the columns, and those of headers, in which case and signs do not matter."""

URBAN = ("o_zone", "d_zone", "intersection", "section", "direction", "movement")
OPTIONAL = (*URBAN, "preceding", "following", "space_headway", "time_headway", "total_frames")
"""Columns that may be absent or empty; -1 is unknown in those of whole numbers."""

MOTORWAY_COLUMNS = tuple(name for name in NAMES if name not in URBAN and name != "location")
STREET_COLUMNS = tuple(name for name in NAMES if name != "location")
TEXT_COLUMNS = {len(columns): columns for columns in (MOTORWAY_COLUMNS, STREET_COLUMNS)}
REQUIRED = tuple(name for name in MOTORWAY_COLUMNS if name not in OPTIONAL)

FEET = ("local_x", "local_y", "global_x", "global_y", "length", "width", "speed", "acceleration", "space_headway")
WHOLE = ("vehicle_id", "frame", "total_frames", "time_ms", "vehicle_class", "lane", *URBAN, "preceding", "following")

LENGTHS_IN_FEET = (8.0, 45.0)  # [ft] the median length of any traffic lies within
METRES_BELOW = 8.0  # a median length from 2.5 to this is metres
OFF_SITE_MAX = 0.01  # share of rows of a block that may lie nowhere near their site (these are left out)


@dataclass(frozen=True)
class Layout:
    """How a file is laid out.

    Attributes:
        columns: our names, in the order of the file.
        separator: comma, semicolon or tab of a CSV file; a blank for text.
        start: first byte of data.
        line: number of the first line of data.
    """

    columns: tuple[str, ...]
    separator: str
    start: int
    line: int

    @property
    def title(self) -> str:
        """What a person calls this."""
        kind = "text" if self.separator == " " else "portal CSV" if "location" in self.columns else "CSV"
        return f"official NGSIM {kind}, {len(self.columns)} columns"


@dataclass(frozen=True)
class Block:
    """Consecutive rows of a file.

    Attributes:
        columns: by our names, arrays (n,) in SI units; `site` holds indices of ``SITES``, `line` the line numbers.
        end: byte after the block.
        end_line: number of the line after the block.
        off_site: rows left out as their position is nowhere near their site.
    """

    columns: dict[str, np.ndarray]
    end: int
    end_line: int
    off_site: int


def detect(path: Path) -> Layout | None:
    """How the file at `path` is laid out, or None if it is not NGSIM's; looks at its beginning only.

    Raises:
        InputError: it cannot be read, or is nearly NGSIM's: columns are missing, unknown or of the wrong number.
    """
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if b"\0" in head:
        return None
    start = 3 if head.startswith(b"\xef\xbb\xbf") else 0
    line = 1
    for raw in head[start:].splitlines(keepends=True):
        if raw.strip():
            text = raw.decode("utf-8", "replace").strip()
            return _text_layout(text, start, line, path) or _csv_layout(text, start + len(raw), line + 1, path)
        start, line = start + len(raw), line + 1
    return None


def _text_layout(text: str, start: int, line: int, path: Path) -> Layout | None:
    fields = text.split()
    if len(fields) < 10 or not all(_is_number(field) for field in fields):
        return None
    if len(fields) not in TEXT_COLUMNS:
        raise InputError(f"{path}: line {line}: {len(fields)} columns of numbers; NGSIM's text files have 18 or 24")
    return Layout(TEXT_COLUMNS[len(fields)], " ", start, line)


def _csv_layout(text: str, start: int, line: int, path: Path) -> Layout | None:
    separator = max(",;\t", key=text.count)
    given = [field.strip().strip('"') for field in text.split(separator)]
    ours = {_plain(theirs): name for name, spellings in NAMES.items() for theirs in spellings}
    columns = [ours.get(_plain(field), "") for field in given]
    if not {"vehicle_id", "frame", "time_ms"} <= set(columns):
        return None
    missing = [name for name in REQUIRED if name not in columns]
    unknown = [field for field, name in zip(given, columns, strict=True) if not name]
    twice = sorted({name for name in columns if name and columns.count(name) > 1})
    if missing or unknown or twice:
        raise InputError(
            f"{path}: line {line - 1}: an NGSIM header with columns missing {missing}, unknown {unknown}, twice {twice}"
        )
    return Layout(tuple(columns), separator, start, line)


def _plain(field: str) -> str:
    return "".join(c for c in field.lower() if c.isalnum())


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


class BlockReader:
    """Reads a file block by block.

    Args:
        path: of the file.
        layout: as :func:`detect` says.
        wanted: our names of the columns to read; those that the file has not are left out.
        truncated: whether a last line that ends too early is left out instead of refused.
    """

    def __init__(self, path: Path, layout: Layout, wanted: Sequence[str], *, truncated: bool = False) -> None:
        """Nothing is read yet."""
        needed = {*wanted, "time_ms", "global_x", "global_y", "length"} | ({"location"} & set(layout.columns))
        self.path, self.layout = path, layout
        self._wanted = [name for name in layout.columns if name in needed]
        self._truncated = truncated
        self._commas: set[str] = set()  # columns in which thousands commas were seen
        self._site: int | None = None  # of files without a column for it
        self._units_known = False

    def blocks(self, start: int | None = None, line: int | None = None) -> Iterator[Block]:
        """Blocks from byte `start`, which begins line `line`, on; from the first row if not given.

        Raises:
            InputError: a line cannot be read, units or positions are not NGSIM's, or the file ends within a line.
        """
        start = self.layout.start if start is None else start
        line = self.layout.line if line is None else line
        with self.path.open("rb") as file:
            file.seek(start)
            while data := file.read(BLOCK):
                cut = data.rfind(b"\n") + 1
                if len(data) < BLOCK:
                    data += file.read()  # nothing, or what was appended in between
                    cut = len(data)
                elif not cut:
                    raise InputError(f"{self.path}: line {line}: no end of line within {BLOCK} bytes")
                block, data_end = data[:cut], start + cut
                file.seek(data_end)
                yield self._block(block, data_end, line)
                start, line = data_end, line + block.count(b"\n") + (not block.endswith(b"\n"))

    def _block(self, data: bytes, end: int, line: int) -> Block:
        end_line = line + data.count(b"\n") + (not data.endswith(b"\n"))
        if not data.endswith(b"\n"):
            data = self._complete(data, end_line - 1)
        if not data.strip():
            return Block({name: np.empty(0) for name in (*self._wanted, "site", "line")}, end, end_line, 0)
        table = self._parse(data, line)
        lines = self._lines(data, line, len(table))
        columns = {name: self._numbers(table, name, lines) for name in self._wanted if name != "location"}
        self._check_units(columns["length"])
        for name in FEET:
            if name in columns:
                columns[name] = columns[name] * FOOT
        columns["site"] = self._sites(table, columns, lines)
        columns["line"] = lines
        keep = self._on_site(columns, lines)
        off_site = int((~keep).sum())
        if off_site:
            columns = {name: values[keep] for name, values in columns.items()}
        return Block(columns, end, end_line, off_site)

    def _complete(self, data: bytes, line: int) -> bytes:
        """`data`, whose last line has no end, made whole: cut back or refused if that line has too few columns."""
        head, _, tail = data.rpartition(b"\n")
        count = len(self._split(tail.decode("utf-8", "replace")))
        if not tail.strip() or count == len(self.layout.columns):
            return data + b"\n"
        if self._truncated:
            return head + b"\n" if head else b""
        raise InputError(
            f"{self.path}: line {line}: the file ends within this line, after {count} of {len(self.layout.columns)} "
            f"columns: it is cut off; get it whole (data download resumes), or read it as it is with --truncated"
        )

    def _parse(self, data: bytes, line: int) -> pa.Table:
        """Columns as numbers, or as text where they are not plain numbers."""
        separator = self.layout.separator
        if separator == " ":
            data = re.sub(rb"(?m)^ +| +$", b"", re.sub(rb"[ \t\r]+", b" ", data))
        texts = {"location", *self._commas}
        for _ in range(2):
            types = {name: pa.string() if name in texts else pa.float64() for name in self._wanted}
            try:
                return pcsv.read_csv(
                    pa.BufferReader(data),
                    read_options=pcsv.ReadOptions(column_names=list(self.layout.columns)),
                    parse_options=pcsv.ParseOptions(delimiter=separator),
                    convert_options=pcsv.ConvertOptions(column_types=types, include_columns=self._wanted),
                )
            except pa.ArrowInvalid:
                texts = set(self._wanted)  # all as text: the cells say which of them is wrong
        raise self._bad_line(data, line)

    def _split(self, text: str) -> list[str]:
        if self.layout.separator == " ":
            return text.split()
        return next(csv.reader(io.StringIO(text), delimiter=self.layout.separator), [])

    def _bad_line(self, data: bytes, line: int) -> InputError:
        """The first line with a wrong number of columns, as an error."""
        expected = len(self.layout.columns)
        for number, raw in enumerate(data.splitlines(), line):
            count = len(self._split(raw.decode("utf-8", "replace")))
            if count not in (0, expected):
                return InputError(f"{self.path}: line {number}: {count} columns, expected {expected}: {_short(raw)}")
        return InputError(f"{self.path}: lines {line} and after: not readable as {self.layout.title}")

    @staticmethod
    def _lines(data: bytes, line: int, rows: int) -> IntArray:
        """Line number of every row; empty lines are no rows."""
        if data.count(b"\n") == rows:
            return np.arange(line, line + rows)
        full = [number for number, raw in enumerate(data.splitlines(), line) if raw.strip()]
        return np.array(full, np.int64)

    def _numbers(self, table: pa.Table, name: str, lines: IntArray) -> np.ndarray:
        """One column as numbers: whole ones as int64 with -1 for unknown, others as float64 with NaN for unknown."""
        column = table.column(name)
        if pa.types.is_string(column.type):
            column = self._from_text(column, name, lines)
        values = column.to_numpy(zero_copy_only=False)
        values = np.asarray(values, np.float64)
        unknown = ~np.isfinite(values)
        if unknown.any():
            if name not in OPTIONAL:
                raise self._error(lines, unknown, f"column {self._given(name)} is empty or not finite")
            values = np.where(unknown, -1.0 if name in WHOLE else np.nan, values)
        if name not in WHOLE:
            return values
        whole = values.astype(np.int64)
        if (whole != values).any():
            at = int(np.argmax(whole != values))
            raise self._error(lines, whole != values, f"column {self._given(name)} is {values[at]:g}, no whole number")
        return whole

    def _from_text(self, column: pa.ChunkedArray, name: str, lines: IntArray) -> pa.ChunkedArray:
        plain = pc.utf8_trim_whitespace(column)
        without = pc.replace_substring(plain, ",", "")
        if not pc.all(pc.equal(plain, without)).as_py():
            self._commas.add(name)
        if name in OPTIONAL:
            without = pc.if_else(pc.is_in(without, pa.array(["", "NA", "NULL", "null", "NaN"])), None, without)
        try:
            return pc.cast(without, pa.float64())
        except pa.ArrowInvalid:
            bad = np.array([not _is_number(text) for text in without.to_pylist()])
            cell = column[int(np.argmax(bad))].as_py()
            raise self._error(lines, bad, f"column {self._given(name)} is {cell!r}, no number") from None

    @staticmethod
    def _given(name: str) -> str:
        return NAMES[name][0]

    def _error(self, lines: IntArray, bad: BoolArray, what: str) -> InputError:
        more = int(bad.sum()) - 1
        also = f"; and {more} more such rows in this block" if more else ""
        return InputError(f"{self.path}: line {lines[int(np.argmax(bad))]}: {what}{also}")

    def _check_units(self, length: FloatArray) -> None:
        """Refuse metres: the lengths of vehicles tell."""
        if self._units_known or len(length) == 0:
            return
        median = float(np.median(length))
        low, high = LENGTHS_IN_FEET
        if not low <= median <= high:
            metric = 2.5 <= median < METRES_BELOW
            guess = (
                "metres: NGSIM is published in feet, so use the generic import for this file" if metric else "no feet"
            )
            raise InputError(
                f"{self.path}: line {self.layout.line} and after: column v_Length has median {median:g}, expected "
                f"{low:g} to {high:g} ft; this looks like {guess}"
            )
        self._units_known = True

    def _sites(self, table: pa.Table, columns: dict[str, np.ndarray], lines: IntArray) -> IntArray:
        """Index of the site of every row."""
        names = list(SITES)
        if "location" not in self.layout.columns:
            if self._site is None:
                first = (float(columns[name][0]) for name in ("time_ms", "global_x", "global_y"))
                site = site_of(*first, urban="direction" in self.layout.columns)
                if site is None:
                    raise self._position_error(columns, lines, np.ones(len(lines), np.bool_))
                self._site = names.index(site.name)
            return np.full(len(lines), self._site, np.int64)
        encoded = table.column("location").combine_chunks().dictionary_encode()
        spelled = [text or "" for text in encoded.dictionary.to_pylist()]
        sites = [site_at(text) for text in spelled]
        codes = np.array([names.index(site.name) if site else -1 for site in sites], np.int64)
        index = codes[encoded.indices.fill_null(0).to_numpy(zero_copy_only=False)]
        if (index < 0).any():
            text = spelled[int(encoded.indices[int(np.argmax(index < 0))].as_py() or 0)]
            known = ", ".join(site.location for site in SITES.values())
            raise self._error(lines, index < 0, f"column Location is {text!r}, expected one of {known}")
        return index

    def _on_site(self, columns: dict[str, np.ndarray], lines: IntArray) -> BoolArray:
        """Which rows (n,) have a position on their site."""
        keep = np.zeros(len(lines), np.bool_)
        for index, site in enumerate(SITES.values()):
            here = columns["site"] == index
            keep[here] = site.holds(columns["global_x"][here], columns["global_y"][here])
        if (~keep).mean() > OFF_SITE_MAX:
            raise self._position_error(columns, lines, ~keep)
        return keep

    def _position_error(self, columns: dict[str, np.ndarray], lines: IntArray, bad: BoolArray) -> InputError:
        at = int(np.argmax(bad))
        x, y = (float(columns[name][at]) / FOOT for name in ("global_x", "global_y"))
        metric = any(site.holds(np.array([x]), np.array([y]))[0] for site in SITES.values())
        guess = "; these are metres: NGSIM is published in feet, use the generic import" if metric else ""
        return self._error(
            lines, bad, f"Global_X, Global_Y are {x:.1f}, {y:.1f}, at no NGSIM site in feet of the State Plane{guess}"
        )


def _short(raw: bytes, limit: int = 60) -> str:
    text = raw.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= limit else text[:limit] + "...")
