"""Tables that people give as CSV or Parquet: what is wrong is said by file, and by line or row."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

from litsim_sim.core.errors import InputError
from litsim_sim.io.parquet_input import UNREADABLE, is_parquet

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class TableFile:
    """A file of rows, as errors name it and its places.

    Attributes:
        path: of the file.
        parquet: whether it is Parquet, not CSV.
        columns: their names.
    """

    path: Path
    parquet: bool
    columns: tuple[str, ...]

    @classmethod
    def open(cls, path: Path) -> TableFile:
        """Look at the file at `path`.

        Raises:
            InputError: it is neither CSV nor Parquet.
        """
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        try:
            parquet = is_parquet(path)
            if parquet:
                return cls(path, parquet, tuple(pq.read_schema(path).names))
            with pcsv.open_csv(path) as reader:
                return cls(path, parquet, tuple(reader.schema.names))
        except UNREADABLE as error:
            raise cls._unreadable(path, error) from error

    def __str__(self) -> str:
        return str(self.path)

    def at(self, *rows: int) -> str:
        """The place of some rows: lines of a CSV file, or rows of a Parquet file, the first being 1."""
        word = "row" if self.parquet else "line"
        return f"{self.path}: {word}{'s' if len(rows) > 1 else ''} {' and '.join(map(str, rows))}"

    def read(self, wanted: list[str], *, whose: str = "", may_be_empty: bool = False) -> pd.DataFrame:
        """The columns `wanted`, and `row`, by which :meth:`at` names a place.

        Args:
            wanted: names of columns.
            whose: said of columns that are missing, such as "of the mapping".
            may_be_empty: whether a table without rows is one.

        Raises:
            InputError: it cannot be read, lacks a column, or holds no rows.
        """
        import pandas as pd

        missing = sorted(set(wanted) - set(self.columns))
        if missing:
            said = f"columns {missing}{f' {whose}' if whose else ''} are missing"
            raise InputError(f"{self}: {said}; the file has {list(self.columns)}")
        twice = sorted({name for name in wanted if self.columns.count(name) > 1})
        if twice:
            raise InputError(f"{self}: several columns are called {twice}; expected names that tell columns apart")
        try:
            if self.parquet:
                arrow = pq.read_table(self.path, columns=wanted, page_checksum_verification=True)
            else:
                options = pcsv.ConvertOptions(include_columns=wanted, strings_can_be_null=True)
                arrow = pcsv.read_csv(self.path, convert_options=options)
        except UNREADABLE as error:
            raise self._unreadable(self.path, error) from error
        if not len(arrow) and not may_be_empty:
            raise InputError(f"{self}: holds no rows")
        table = pd.DataFrame({name: arrow.column(name).to_pandas() for name in wanted})
        return table.assign(row=np.arange(len(table)) + (1 if self.parquet else 2))  # a CSV's first line has the names

    @staticmethod
    def _unreadable(path: Path, error: Exception) -> InputError:
        return InputError(f"{path}: not readable as CSV or Parquet: {' '.join(str(error).split())}")
