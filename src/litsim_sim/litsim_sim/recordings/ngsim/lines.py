"""Lines of NGSIM's official files as columns of numbers; a line that cannot be read is said with its number."""

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

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, IntArray
from litsim_sim.recordings.ngsim.formats import NAMES, OPTIONAL, WHOLE, Layout, is_number


def row_error(path: Path, lines: IntArray, bad: BoolArray, what: str) -> InputError:
    """The error that says `what` of the first of the `bad` rows, and how many more there are.

    Args:
        path: of the file.
        lines: (n,) line numbers of the rows.
        bad: (n,) which rows are meant; at least one.
        what: is wrong with the first of them.
    """
    more = int(bad.sum()) - 1
    also = f"; and {more} more such rows in this block" if more else ""
    return InputError(f"{path}: line {lines[int(np.argmax(bad))]}: {what}{also}")


class LineParser:
    """Turns whole lines of a file into columns, in the units of the file.

    Args:
        path: of the file, for errors.
        layout: as :func:`litsim_sim.recordings.ngsim.formats.detect` says.
        wanted: our names of the columns to read.
    """

    def __init__(self, path: Path, layout: Layout, wanted: Sequence[str]) -> None:
        self._path, self._layout, self._wanted = path, layout, list(wanted)
        self._commas: set[str] = set()  # columns in which thousands commas were seen

    def parse(self, data: bytes, line: int) -> pa.Table:
        """The wanted columns of `data`, which begins with line `line`: numbers, or text where any is no plain number.

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
                texts = set(self._wanted)  # all as text: the cells say which of them is wrong
        raise self._bad_line(data, line)

    def split(self, text: str) -> list[str]:
        """The texts of the cells of one line, in the order of the columns."""
        if self._layout.separator == " ":
            return text.split()
        return next(csv.reader(io.StringIO(text), delimiter=self._layout.separator), [])

    def numbers(self, table: pa.Table, name: str, lines: IntArray) -> np.ndarray:
        """One column of `table` as numbers (n,), in the units of the file.

        Args:
            table: as :meth:`parse` gives it.
            name: our name of the column.
            lines: (n,) line numbers of the rows.

        Returns:
            int64 with -1 for unknown where the column holds whole numbers, else float64 with NaN for unknown.

        Raises:
            InputError: a cell is no number, no whole number, or empty where it must not be.
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
        with np.errstate(invalid="ignore"):  # numbers beyond those that there are, which differ from what they become
            whole = values.astype(np.int64)
        if (whole != values).any():
            at = int(np.argmax(whole != values))
            what = f"column {NAMES[name][0]} is {values[at]:g}, no whole number"
            raise row_error(self._path, lines, whole != values, what)
        return whole

    def _from_text(self, column: pa.ChunkedArray, name: str, lines: IntArray) -> pa.ChunkedArray:
        """A column of text as float64, without thousands commas; null for unknown where that may be."""
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
        """The first line with a wrong number of columns, as an error."""
        expected = len(self._layout.columns)
        for number, raw in enumerate(data.splitlines(), line):
            count = len(self.split(raw.decode("utf-8", "replace")))
            if count not in (0, expected):
                return InputError(f"{self._path}: line {number}: {count} columns, expected {expected}: {_short(raw)}")
        return InputError(f"{self._path}: lines {line} and after: not readable as {self._layout.title}")


def line_numbers(path: Path, data: bytes, line: int, rows: int) -> IntArray:
    """Line number (n,) of each of the `rows` rows of `data`, which begins with line `line`; empty lines are no rows.

    Raises:
        InputError: there are other than `rows` lines: a quotation mark that nobody closed made one cell of several.
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
