"""Where rows were recorded, by name or by position."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from litsim_data.ngsim.formats import Layout
from litsim_data.ngsim.row_sites import SiteFinder
from litsim_data.ngsim.sites import FOOT, SITES
from litsim_sim.core.errors import InputError
from made_ngsim import Traffic, table

NAMES = list(SITES)


def rows(*names: str) -> dict[str, Any]:
    """Columns of a row at each of the sites of these names, in the middle of their first period."""
    made = [table(Traffic(SITES[name], SITES[name].periods[0], rows=50, noise=0.0)).iloc[0] for name in names]
    at = {axis: np.array([row[axis] * FOOT for row in made]) for axis in ("global_x", "global_y")}
    return at | {"time_ms": np.array([row["time_ms"] for row in made])}


def finder(*columns: str) -> SiteFinder:
    return SiteFinder(Path("made.csv"), Layout(columns, ",", 0, 1))


def test_sites_by_the_column_in_any_spelling() -> None:
    texts = pa.table({"location": pa.chunked_array([["us-101", "i-80", "us-101"]])})
    found = finder("location").sites(texts, rows("us101", "i80", "us101"), np.arange(3))
    assert [NAMES[index] for index in found] == ["us101", "i80", "us101"]
    with pytest.raises(InputError, match=r"made\.csv: line 1: column Location is 'moon', expected one of"):
        finder("location").sites(pa.table({"location": pa.chunked_array([["i-80", "moon"]])}), {}, np.arange(2))


def test_without_the_column_the_first_position_decides_for_the_whole_file() -> None:
    one = finder("global_x")
    assert [NAMES[index] for index in one.sites(pa.table({}), rows("i80"), np.arange(1))] == ["i80"]
    assert [NAMES[index] for index in one.sites(pa.table({}), rows("us101"), np.arange(1))] == ["i80"]


def test_positions_that_are_at_no_site() -> None:
    columns = rows(*["us101"] * 200) | {"site": np.full(200, NAMES.index("us101"))}
    columns["global_x"][3] = 0.0
    assert np.flatnonzero(~finder().on_site(columns, np.arange(200))).tolist() == [3]
    columns["global_x"][:9] = 0.0
    with pytest.raises(InputError, match=r"line 0: Global_X, Global_Y are 0\.0, .* at no NGSIM site"):
        finder().on_site(columns, np.arange(200))
    metres = rows("us101")
    for axis in ("global_x", "global_y"):
        metres[axis] = metres[axis] * FOOT
    with pytest.raises(InputError, match="these are metres"):
        finder("global_x").sites(pa.table({}), metres, np.arange(1))
