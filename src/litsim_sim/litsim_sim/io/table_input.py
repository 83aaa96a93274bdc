"""Reading of tables of users, as CSV or Parquet; errors name the file, and the line or row."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import open_input, packing_of, read_head, require_file
from litsim_sim.io.parquet_input import UNREADABLE, check_unpacked, is_parquet

if TYPE_CHECKING:
    import pandas as pd

ROWS_MAX = 10**12  # most rows of one of several files; row numbers of each file begin at a multiple of it
ARROW_MAGIC = b"ARROW1"
HEAD_BYTES = 65_536  # of the first line of a table, with the names of its columns
CLOCK = r"([01]?\d|2[0-4]):[0-5]\d:[0-5]\d(\.\d+)?"
"""Pattern of times of the day."""
SEPARATORS = (";", "\t", "|")
"""Separators of cells other than commas; by the first line of a file, which has no comma then."""


@dataclass(frozen=True)
class TableFile:
    """A file with a table, and the places of its rows for errors.

    Attributes:
        path: the file.
        parquet: whether it is Parquet, not CSV.
        columns: their names.
        separator: what separates the cells of a CSV file.
    """

    path: Path
    parquet: bool
    columns: tuple[str, ...]
    separator: str = ","

    @classmethod
    def open(cls, path: Path) -> TableFile:
        """Read the names of the columns of a file; raises InputError if it is neither CSV nor Parquet."""
        require_file(path)
        parquet, separator = False, ","
        try:
            if read_head(path, len(ARROW_MAGIC)) == ARROW_MAGIC:
                raise InputError(
                    f"{path}: is an Arrow file (Feather), expected CSV or Parquet: pandas.read_feather reads it"
                )
            parquet = is_parquet(path)
            if parquet:
                return cls(path, parquet, tuple(pq.read_schema(path).names))
            with open_input(path) as file:
                separator = separator_of(next((line for line in file if line.strip()), b""))
            with pcsv.open_csv(_csv(path), parse_options=pcsv.ParseOptions(delimiter=separator)) as reader:
                return cls(path, parquet, tuple(reader.schema.names), separator)
        except UNREADABLE as error:
            raise _unreadable(path, error, separator="" if parquet else separator) from error

    def __str__(self) -> str:
        return str(self.path)

    def place(self, *rows: int) -> str:
        """Returns a text that names the places of `rows`: lines of a CSV file, or rows of a Parquet file, from 1."""
        return places(self.path, "row", rows) if self.parquet else places(self.path, "line", _lines(self.path, rows))

    def read(self, wanted: list[str], *, whose: str = "", may_be_empty: bool = False) -> pd.DataFrame:
        """Returns the columns `wanted`, and `row`, the number for :meth:`place`; empty lines of a CSV file are skipped.

        Raises an InputError if the file cannot be read, lacks a column (`whose`, such as "of the mapping", is
        added then), or holds no rows and not `may_be_empty`.
        """
        import pandas as pd

        missing = sorted(set(wanted) - set(self.columns))
        if missing:
            columns = f"columns {missing}{f' {whose}' if whose else ''}"
            raise InputError(f"{self}: {columns} are missing; the file has {list(self.columns)}")
        twice = sorted({name for name in wanted if self.columns.count(name) > 1})
        if twice:
            raise InputError(f"{self}: several columns are called {twice}; expected names that tell columns apart")
        try:
            if self.parquet:
                check_unpacked(pq.read_metadata(self.path), self.path.stat().st_size, str(self.path))
                arrow = pq.read_table(self.path, columns=wanted, page_checksum_verification=True)
            else:
                options = pcsv.ConvertOptions(include_columns=wanted, strings_can_be_null=True)
                parse = pcsv.ParseOptions(delimiter=self.separator)
                arrow = pcsv.read_csv(_csv(self.path), parse_options=parse, convert_options=options)
                if any(pa.types.is_binary(field.type) for field in arrow.schema):
                    raise UnicodeError("some cells are no text")  # pyarrow's way of reading what is not UTF-8
            table = pd.DataFrame({name: arrow.column(name).to_pandas() for name in wanted})  # here texts are decoded
        except UNREADABLE as error:
            raise _unreadable(self.path, error, separator="" if self.parquet else self.separator) from error
        if not len(arrow) and not may_be_empty:
            raise InputError(f"{self}: holds no rows")
        return table.assign(row=np.arange(len(table)) + (1 if self.parquet else 2))  # the names are in a CSV's first


@dataclass(frozen=True)
class TableFiles:
    """Several files whose rows form one table, and the places of these rows for errors.

    Attributes:
        files: at least one, each CSV or Parquet.
        columns: names of the columns of all files; cells of columns that a file lacks are empty.
    """

    files: tuple[TableFile, ...]
    columns: tuple[str, ...]

    @classmethod
    def open(cls, paths: Path | Sequence[Path]) -> TableFiles:
        """Open the files at `paths`; raises InputError if one is neither CSV nor Parquet, or given twice."""
        every = [paths] if isinstance(paths, Path) else list(paths)
        for number, path in enumerate(every):
            if path.resolve() in [other.resolve() for other in every[:number]]:
                raise InputError(f"{path}: is given twice")
        files = tuple(TableFile.open(path) for path in every)
        # A name that a file has twice stays twice: `read` refuses it.
        names = [name for file in files for name in file.columns]
        return cls(files, files[0].columns if len(files) == 1 else tuple(dict.fromkeys(names)))

    def __str__(self) -> str:
        return ", ".join(map(str, self.files))

    @property
    def name(self) -> str:
        """Names of the files, without folders."""
        return ", ".join(file.path.name for file in self.files)

    @property
    def folder(self) -> Path:
        """The folder of the first file."""
        return self.files[0].path.parent

    def place(self, *rows: int) -> str:
        """Like :meth:`TableFile.place`, for `rows` of :meth:`read`."""
        by_file: dict[int, list[int]] = {}
        for row in rows:
            by_file.setdefault(int(row) // ROWS_MAX, []).append(int(row) % ROWS_MAX)
        return " and ".join(self.files[number].place(*its) for number, its in by_file.items())

    def read(self, wanted: list[str], *, needed: set[str] | None = None, whose: str = "") -> pd.DataFrame:
        """Returns the columns `wanted` of all files, one after the other, and `row`, the number for :meth:`place`.

        Raises an InputError as :meth:`TableFile.read`. Only those `needed` must be in every file; None for all.
        """
        import pandas as pd

        somewhere = set(self.columns) - (set(wanted) if needed is None else needed)
        pieces = []
        for number, file in enumerate(self.files):
            table = file.read([name for name in wanted if name in file.columns or name not in somewhere], whose=whose)
            pieces.append(table.assign(row=table["row"] + number * ROWS_MAX))
        return pieces[0] if len(pieces) == 1 else pd.concat(pieces, ignore_index=True)


def places(path: Path, word: str, numbers: Sequence[int]) -> str:
    """Returns a text that names places in a file by a word and their numbers, such as `a.csv: lines 3 and 4`."""
    return f"{path}: {word}{'s' if len(numbers) > 1 else ''} {' and '.join(map(str, numbers))}"


def _lines(path: Path, rows: Sequence[int]) -> list[int]:
    """Line number of each of `rows` in a CSV file; rows count the non-empty lines, from 1."""
    with io.TextIOWrapper(open_input(path), "latin-1") as file:  # any end of lines
        full = (number for number, line in enumerate(file, 1) if line.strip("\n"))
        lines = dict(enumerate(islice(full, max(rows)), 1))
    return [lines[row] for row in rows]


def first_cells(path: Path) -> set[str]:
    """Returns the cells in the first line of a file, if it is CSV, by which formats are recognised."""
    first = read_head(path, HEAD_BYTES).partition(b"\n")[0]
    return {cell.strip() for cell in first.decode("utf-8-sig", "replace").split(separator_of(first))}


def is_stamped(column: pd.Series) -> bool:
    """Returns whether a column of times holds dates with times of the day, such as 2024-05-17T08:30:00.040.

    Times of the day alone, such as 08:30:00.04, are likewise.
    """
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(column):
        return True
    if pd.api.types.is_numeric_dtype(column):
        return False
    first = next((str(value).strip() for value in column if not pd.isna(value)), "")
    return re.fullmatch(CLOCK, first) is not None


def seconds_of(column: pd.Series) -> pd.Series:
    """Times of such a column as seconds since 1970 UTC, or since midnight; NaN for none.

    UTC is assumed for those without a time zone.
    """
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(column):
        return (pd.to_datetime(column, utc=True) - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
    clock = column.astype(str).str.strip()
    return pd.to_timedelta(clock.where(clock.str.fullmatch(CLOCK)), errors="coerce").dt.total_seconds()


def _csv(path: Path) -> Path | BinaryIO:
    """Returns what pyarrow reads a CSV file from; from paths it reads faster."""
    return open_input(path) if packing_of(path) else path


def _unreadable(path: Path, error: Exception, *, separator: str) -> InputError:
    """Returns an error about a file that cannot be read; `separator` is empty for Parquet."""
    with suppress(OSError):  # that is the error
        if separator and (line := _first_odd_line(path, separator)):
            return InputError(f"{path}: {line}")
    return InputError(f"{path}: not readable as CSV or Parquet: {' '.join(str(error).split())}")


def _first_odd_line(path: Path, separator: str) -> str:
    """Returns a text on the first bad line of an unreadable CSV file: its number, and how it differs; else empty."""
    with open_input(path) as file:
        columns = 0
        for number, raw in enumerate(file, 1):
            try:
                text = raw.decode("utf-8-sig" if number == 1 else "utf-8")
                cells = next(csv.reader([text], delimiter=separator), [])
            except UnicodeDecodeError as error:
                return f"line {number}: not UTF-8: {error.reason} {raw[error.start : error.end]!r}"
            except csv.Error as error:
                return f"line {number}: {error}"
            columns = columns or len(cells)
            if cells and len(cells) != columns:
                return f"line {number}: {len(cells)} cells, expected {columns} as in the first line"
    return ""


def separator_of(first: bytes) -> str:
    """Returns the separator of cells in a CSV file with this `first` line."""
    return next((mark for mark in SEPARATORS if b"," not in first and mark.encode() in first), ",")
