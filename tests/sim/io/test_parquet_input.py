"""Parquet files: what is wrong with one is said by file and column."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.io.parquet_input import plain_columns, read_arrow, read_schema, read_table


def test_all_columns_are_read(tmp_path: Path) -> None:
    given = pd.DataFrame({"frame": [1, 2], "x": [0.5, 1.5], "name": ["a", "b"]})
    given.to_parquet(tmp_path / "a.parquet")
    pd.testing.assert_frame_equal(read_table(tmp_path / "a.parquet", ("x", "frame")), given)
    assert read_schema(tmp_path / "a.parquet").names == read_arrow(tmp_path / "a.parquet").column_names == [*given]


@pytest.mark.parametrize("read", [read_schema, read_arrow, read_table])
def test_what_is_no_parquet_file(read, tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    with pytest.raises(InputError, match=f"^{path}: no such file$"):
        read(path)
    with pytest.raises(InputError, match=f"^{tmp_path}: is a folder, expected a file$"):
        read(tmp_path)
    path.write_text("PAR1 and no more")
    with pytest.raises(InputError, match=f"^{path}: not a readable Parquet file: "):
        read(path)


def test_missing_columns_and_a_missing_file(tmp_path: Path) -> None:
    pd.DataFrame({"x": [1.0]}).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"a\.parquet: missing columns \['y'\]; expected \['x', 'y'\]"):
        read_table(tmp_path / "a.parquet", ("x", "y"))
    with pytest.raises(InputError, match=r"b\.parquet: no such file$"):
        read_table(tmp_path / "b.parquet")


def test_plain_numbers_are_read_as_pandas_would() -> None:
    whole, broken = np.arange(20, dtype=np.int16), np.where(np.arange(20) % 3, np.arange(20) / 7, np.nan)
    given = pd.DataFrame({"whole": whole, "broken": broken.astype(np.float32), "name": "a", "index": whole + 5})
    given["holes"] = pd.array(np.where(whole % 2, whole, pd.NA), "Int64")
    arrow = pa.Table.from_pandas(given.set_index("index"))
    parts = pa.concat_tables([arrow.slice(3, 9), arrow.slice(12)]).append_column("broken_", arrow["broken"].slice(3))
    found, expected = plain_columns(parts), parts.to_pandas()
    assert list(found) == ["whole", "broken", "broken_"], "no words, no whole numbers with gaps, no index"
    for name, values in found.items():
        assert values.dtype == expected[name].dtype
        np.testing.assert_array_equal(values, expected[name])
    assert np.isnan(found["broken"]).sum() == 6
    assert not plain_columns(pa.table([[1], [2]], names=["twice", "twice"]))
    assert plain_columns(parts.slice(0, 0))["whole"].tolist() == []
