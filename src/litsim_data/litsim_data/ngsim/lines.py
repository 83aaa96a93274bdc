"""Parsing of lines of NGSIM's official files to numeric columns; errors name the line."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv

from litsim_data.ngsim.formats import NAMES, OPTIONAL, WHOLE, Layout, is_number
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, IntArray


def row_error(path: Path, lines: IntArray, bad: BoolArray, what: str) -> InputError:
    """An error about the first of the `bad` rows, with the number of the others.

    Args:
        path: the file.
        lines: (n,) line numbers of the rows.
        bad: (n,) mask of the bad rows, at least one.
        what: what is wrong with the first of them.
    """
    more = int(bad.sum()) - 1
    also = f"; and {more} more such rows in this block" if more else ""
    return InputError(f"{path}: line {lines[int(np.argmax(bad))]}: {what}{also}")


class LineParser:
    """Parses complete lines of a file to columns, in the units of the file.

    Args:
        path: the file, for errors.
        layout: see :func:`litsim_data.ngsim.formats.detect`.
        wanted: our names of the columns to read.
    """

    def __init__(self, path: Path, layout: Layout, wanted: Sequence[str]) -> None:
        self._path, self._layout, self._wanted = path, layout, list(wanted)
        self._commas: set[str] = set()  # columns with thousands commas so far

    def parse(self, data: bytes, line: int) -> pa.Table:
        """The wanted columns of `data`, which begins at line `line`; columns with any non-numeric cell are text.

        Raises:
            InputError: a line has too few or too many columns.
        """
        separator = self._layout.separator
        if separator == " ":
            data = re.sub(rb"(?m)^ +| +$", b"", re.sub(rb"[ \t\r]+", b" ", data))
        texts = {"location", *self._commas}
        for _ in range(2):
            types = {name: pa.string() if name in texts else pa.float64() for name in self._wanted}
            try:
                return pcsv.read_csv(
                    pa.BufferReader(data),
                    read_options=pcsv.ReadOptions(column_names=list(self._layout.columns)),
                    parse_options=pcsv.ParseOptions(delimiter=separator, quote_char=separator != " " and '"'),
                    convert_options=pcsv.ConvertOptions(column_types=types, include_columns=self._wanted),
                )
            except pa.ArrowInvalid:
                texts = set(self._wanted)  # all as text, so that errors can name the cell
        raise self._bad_line(data, line)

    def split(self, text: str) -> list[str]:
        """The texts of the cells of one line, in the order of the columns."""
        if self._layout.separator == " ":
            return text.split()
        return next(csv.reader(io.StringIO(text), delimiter=self._layout.separator), [])

    def numbers(self, table: pa.Table, name: str, lines: IntArray) -> np.ndarray:
        """One column of `table` as numbers (n,), in the units of the file.

        Args:
            table: see :meth:`parse`.
            name: our name of the column.
            lines: (n,) line numbers of the rows.

        Returns:
            int64 with -1 for unknown for an integer column, else float64 with NaN for unknown.

        Raises:
            InputError: a cell is not a number, not an integer, or empty where it must not be.
        """
        column = table.column(name)
        if pa.types.is_string(column.type):
            column = self._from_text(column, name, lines)
        values = column.to_numpy(zero_copy_only=False)
        values = np.asarray(values, np.float64)
        unknown = ~np.isfinite(values)
        if unknown.any():
            if name not in OPTIONAL:
                raise row_error(self._path, lines, unknown, f"column {NAMES[name][0]} is empty or not finite")
            values = np.where(unknown, -1.0 if name in WHOLE else np.nan, values)
        if name not in WHOLE:
            return values
        with np.errstate(invalid="ignore"):  # values beyond int64 differ after the cast
            whole = values.astype(np.int64)
        if (whole != values).any():
            at = int(np.argmax(whole != values))
            what = f"column {NAMES[name][0]} is {values[at]:g}, no whole number"
            raise row_error(self._path, lines, whole != values, what)
        return whole

    def _from_text(self, column: pa.ChunkedArray, name: str, lines: IntArray) -> pa.ChunkedArray:
        """A text column as float64, without thousands commas; unknown is null in optional columns."""
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
            raise row_error(self._path, lines, bad, f"column {NAMES[name][0]} is {cell!r}, no number") from None

    def _bad_line(self, data: bytes, line: int) -> InputError:
        """An error about the first line with a wrong number of columns."""
        expected = len(self._layout.columns)
        for number, raw in enumerate(data.splitlines(), line):
            count = len(self.split(raw.decode("utf-8", "replace")))
            if count not in (0, expected):
                return InputError(f"{self._path}: line {number}: {count} columns, expected {expected}: {_short(raw)}")
        return InputError(f"{self._path}: lines {line} and after: not readable as {self._layout.title}")


def line_numbers(path: Path, data: bytes, line: int, rows: int) -> IntArray:
    """Line number (n,) of each of the `rows` rows of `data`, which begins at line `line`; empty lines are skipped.

    Raises:
        InputError: the number of lines is not `rows`: an unclosed quotation mark joined several lines.
    """
    if data.count(b"\n") == rows:
        return np.arange(line, line + rows)
    full = {number: raw for number, raw in enumerate(data.splitlines(), line) if raw.strip()}
    if len(full) != rows:
        opened = next((number for number, raw in full.items() if raw.count(b'"') % 2), line)
        raise InputError(f"{path}: line {opened}: a quotation mark that is not closed in this line")
    return np.array(list(full), np.int64)


def _short(raw: bytes, limit: int = 60) -> str:
    text = raw.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= limit else text[:limit] + "...")
