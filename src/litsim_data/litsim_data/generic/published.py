"""Mappings of published tables, which the package has: a table is recognised by its columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path

from litsim_data.generic.mapping import Mapping
from litsim_data.generic.wide import is_json
from litsim_sim.io.input_files import read_head
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.io.table_input import first_cells
from litsim_sim.io.yaml_input import read_yaml

OBJECT_BYTES = 4 * 2**20  # of the first object of a file of JSON, whose names are its columns


@cache
def mappings() -> tuple[tuple[Path, Mapping], ...]:
    """Returns the mappings of the package, with their files."""
    paths = sorted(Path(str(files("litsim_data") / "mappings")).glob("*.yaml"))
    return tuple((path, read_yaml(path, Mapping)) for path in paths)


def mapping_of(path: Path) -> tuple[Path, Mapping] | None:
    """Returns the mapping of the package for the table at `path`, with its file; None where it has none.

    Raises:
        InputError: the file cannot be read.
    """
    columns = _columns(path)
    return next(
        (pair for pair in mappings() if {*pair[1].columns.named().values(), *pair[1].repeated} <= columns), None
    )


def drafted(paths: Path | Sequence[Path]) -> str:
    """Returns the text of the mapping of the package for a table; empty where it has none."""
    published = mapping_of(paths if isinstance(paths, Path) else paths[0])
    return "" if published is None else published[0].read_text(encoding="utf-8")


def _columns(path: Path) -> set[str]:
    """Returns the columns of a table, as far as its beginning tells."""
    if is_parquet(path):
        return {*read_schema(path).names}
    if is_json(path):
        return {*re.findall(r'"(\w+)"\s*:', read_head(path, OBJECT_BYTES).decode("utf-8", "replace"))}
    return first_cells(path)
