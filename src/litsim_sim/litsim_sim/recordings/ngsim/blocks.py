"""Rows of NGSIM's official files, block by block, in SI units: feet end here. Every defect is said with its line."""

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

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.recordings.ngsim.formats import FEET, NAMES, OPTIONAL, WHOLE, Layout, is_number
from litsim_sim.recordings.ngsim.sites import FOOT, SITES, site_at, site_of

BLOCK = 16 << 20  # [bytes] read at once
LENGTHS_IN_FEET = (8.0, 45.0)  # [ft] the median length of any traffic lies within
METRES_BELOW = 8.0  # a median length from 2.5 to this is metres
OFF_SITE_MAX = 0.01  # share of rows of a block that may lie nowhere near their site (these are left out)


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


class BlockReader:
    """Reads a file block by block.

    Args:
        path: of the file.
        layout: as :func:`litsim_sim.recordings.ngsim.formats.detect` says.
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
            bad = np.array([not is_number(text) for text in without.to_pylist()])
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
