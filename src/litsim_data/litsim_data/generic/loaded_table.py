"""A table that is in memory, as a source of :func:`litsim_data.generic.convert.convert`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from litsim_data.generic.mapping import Columns
from litsim_data.generic.mapping import Mapping as Meaning
from litsim_sim.core.errors import InputError
from litsim_sim.io.table_input import TableFiles, places


@dataclass(frozen=True)
class TableOfFile(TableFiles):
    """Tracks that a reader takes from a file which is no table of files.

    Attributes:
        path: the file.
    """

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def name(self) -> str:
        """See :class:`TableFiles`."""
        return self.path.name

    @property
    def folder(self) -> Path:
        """See :class:`TableFiles`."""
        return self.path.parent


@dataclass(frozen=True)
class LoadedTable(TableOfFile):
    """Tracks that a reader has taken.

    Attributes:
        table: the tracks, a row for each time at which something is seen.
    """

    table: pd.DataFrame

    @classmethod
    def of(cls, path: Path, content: pd.DataFrame | Mapping[str, Any]) -> LoadedTable:
        """Returns the table of the tracks in `path`: itself, or its columns.

        Raises:
            InputError: there are no rows.
        """
        table = pd.DataFrame(dict(content))
        if table.empty:
            raise InputError(f"{path}: holds no tracks")
        return cls((), tuple(map(str, table.columns)), path, table)

    def meaning(self, kinds: Mapping[str, str], **fields: Any) -> Meaning:
        """Returns the mapping of columns that have our names, and ``vx`` and ``vy`` for components of speed.

        Args:
            kinds: our kind by what column `kind` says; rows of others are left out.
            fields: other fields of the mapping; positions are box centres if `reference` is not among them.
        """
        columns: dict[str, Any] = {name: name for name in self.columns if name in Columns.model_fields}
        if {"vx", "vy"} <= {*self.columns}:
            columns["speed"] = ["vx", "vy"]
        named = {kind: kinds.get(kind, "drop") for kind in self.table["kind"].unique()}
        return Meaning.of_scene(**{"columns": columns, "kinds": named} | fields)

    def place(self, *rows: int) -> str:
        """See :class:`TableFiles`; rows count from 1, in the order of the file."""
        return f"{places(self.path, 'row', rows)} of its tracks"

    def read(self, wanted: list[str], *, needed: set[str] | None = None, whose: str = "") -> pd.DataFrame:  # noqa: ARG002 - all are there
        """See :class:`TableFiles`."""
        if missing := sorted({*wanted} - {*self.columns}):
            raise InputError(f"{self.path}: no columns {missing}; its tracks have {list(self.columns)}")
        return self.table[wanted].assign(row=np.arange(1, len(self.table) + 1))
