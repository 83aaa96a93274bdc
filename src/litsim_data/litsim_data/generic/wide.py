"""Tables with a row for each vehicle, unfolded to a row for each time: repeated columns, and JSON with arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from litsim_data.generic.loaded_table import LoadedTable, TableOfFile
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import open_input, read_head, read_json, require_file
from litsim_sim.io.parquet_input import is_parquet
from litsim_sim.io.table_input import HEAD_BYTES, TableFiles, places, separator_of

SCALARS = (str, int, float, bool, type(None))
FIRST_ROWS = 6  # lines by which repeated columns are recognised
RECORDS = "a list of objects, one for each vehicle or row"


def open_tables(paths: Path | Sequence[Path], repeated: Sequence[str] = ()) -> TableFiles:
    """Returns one file, or several of rows for each time, as a table with a row for each time.

    Args:
        paths: CSV, Parquet or JSON.
        repeated: the last columns of the header, which repeat along each row.

    Raises:
        InputError: a file cannot be read, or is not laid out so.
    """
    first, *others = [paths] if isinstance(paths, Path) else paths
    if others or not (repeated or is_json(first)):
        return TableFiles.open(paths)
    return _unfolded(first, repeated) if repeated else Records.of(first)


def is_json(path: Path) -> bool:
    """Returns whether the file at `path` seems to be JSON."""
    require_file(path)
    return read_head(path).lstrip()[:1] in (b"[", b"{")


@dataclass(frozen=True)
class Records(TableOfFile):
    """A file of JSON: a list of objects, each of a vehicle with arrays of its states, or of one row.

    Attributes:
        records: the objects.
    """

    records: list[dict[str, Any]]

    @classmethod
    def of(cls, path: Path) -> Records:
        """Returns the content of a file; raises InputError if it is no list of objects."""
        try:
            content = read_json(path, RECORDS)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: not readable as JSON: {error}") from error
        if not (isinstance(content, list) and content and all(isinstance(entry, dict) for entry in content)):
            raise InputError(f"{path}: expected {RECORDS}")
        names = dict.fromkeys(name for record in content for name in record)
        return cls((), tuple(names), path, content)

    def place(self, *rows: int) -> str:
        """See :class:`TableFiles`; rows are numbers of objects, from 1."""
        return places(self.path, "object", list(dict.fromkeys(rows)))

    def read(self, wanted: list[str], *, needed: set[str] | None = None, whose: str = "") -> pd.DataFrame:
        """See :class:`TableFiles`; `row` is the number of the object."""
        if missing := sorted((({*wanted} if needed is None else needed) & {*wanted}) - {*self.columns}):
            raise InputError(
                f"{self.path}: columns {missing} {whose} are missing; the objects have {list(self.columns)}"
            )
        columns: dict[str, list[Any]] = {name: [] for name in wanted}
        rows: list[int] = []
        for number, record in enumerate(self.records, 1):
            values = {name: _plain(record.get(name)) for name in wanted}
            lengths = {name: len(value) for name, value in values.items() if isinstance(value, list)}
            if len({*lengths.values()}) > 1:
                counts = ", ".join(f"{name} {length}" for name, length in lengths.items())
                raise InputError(f"{self.place(number)}: arrays differ in length: {counts}")
            count = next(iter(lengths.values()), 1)
            rows += count * [number]
            for name, value in values.items():
                cells = value if isinstance(value, list) else count * [value]
                columns[name] += cells
                if odd := [cell for cell in cells if not isinstance(cell, SCALARS)]:
                    raise InputError(f"{self.place(number)}: {name} holds {odd[0]!s:.40}, expected numbers or texts")
        if not rows:
            raise InputError(f"{self.path}: holds no rows")
        return pd.DataFrame(columns).assign(row=rows)


def _plain(value: Any) -> Any:
    """Returns a value without the object of one field that databases write around ids."""
    return next(iter(value.values())) if isinstance(value, dict) and len(value) == 1 else value


def repeated_columns(path: Path) -> list[str]:
    """Returns the last columns of a CSV file's header that seem to repeat along its rows; empty if none do.

    They are the smallest number of columns that fits the first rows, and of which one ascends along them, as times do.
    """
    lines = [] if is_json(path) or is_parquet(path) else [cells for _, cells in islice(_cells(path), FIRST_ROWS)]
    header, *rows = lines or [[]]
    more = [len(row) - len(header) for row in rows]
    if max(more, default=0) < len(header):
        return []
    for size in range(2, len(header)):
        if gcd(*more) % size == 0 and _ascends(rows[0][len(header) - size :], size):
            return header[-size:]
    return []


def _ascends(cells: Sequence[str], size: int) -> bool:
    """Returns whether one of `size` columns that repeat along a row holds numbers that ascend."""
    try:
        groups = np.array(cells, np.float64).reshape(-1, size)
    except ValueError:  # texts
        return False
    return len(groups) > 1 and bool((np.diff(groups, axis=0) > 0.0).all(axis=0).any())


def _unfolded(path: Path, repeated: Sequence[str]) -> LoadedTable:
    """Returns the table of a CSV file whose columns `repeated`, the last of its header, repeat along each row.

    Raises:
        InputError: the file cannot be read, or a row does not hold whole sets of them, of numbers.
    """
    lines = _cells(path)
    _, header = next(lines, (0, []))
    single, size = len(header) - len(repeated), len(repeated)
    if header[single:] != list(repeated) or single < 1 or len({*header}) < len(header):
        raise InputError(f"{path}: the header is {header}, expected columns of which the last are {list(repeated)}")
    once: list[list[str]] = []
    blocks: list[FloatArray] = []
    for number, cells in lines:
        if (len(cells) - single) % size or len(cells) < single:
            raise InputError(
                f"{path}: line {number}: {len(cells)} cells, expected {single} and then whole sets of {size}, "
                f"{', '.join(repeated)}"
            )
        try:
            blocks.append(np.array(cells[single:], np.float64).reshape(-1, size))
        except ValueError as error:
            raise InputError(f"{path}: line {number}: {error}, expected numbers after cell {single}") from error
        once.append(cells[:single])
    if not blocks:
        raise InputError(f"{path}: holds no rows")
    counts = [len(block) for block in blocks]
    columns: dict[str, object] = {}
    for column, name in enumerate(header[:single]):
        columns[name] = pd.Series([cells[column] for cells in once], dtype=object).repeat(counts).to_numpy()
    return LoadedTable.of(path, columns | dict(zip(repeated, np.concatenate(blocks).T, strict=True)))


def _cells(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yields number and cells of each line of a CSV file that is not empty, without empty cells at the end.

    Raises:
        InputError: the file is not UTF-8.
    """
    separator = separator_of(read_head(path, HEAD_BYTES).partition(b"\n")[0])
    with open_input(path) as file:
        for number, line in enumerate(file, 1):
            try:
                text = line.decode("utf-8-sig").strip()
            except UnicodeDecodeError as error:
                raise InputError(f"{path}: line {number}: not UTF-8: {error.reason}") from error
            if text:
                yield number, [cell.strip() for cell in text.rstrip(f"{separator} ").split(separator)]
