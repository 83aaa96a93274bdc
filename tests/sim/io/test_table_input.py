"""Tables as CSV or Parquet: one way to read both, and places that people find again."""

import gzip
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.io import input_files
from litsim_sim.io.table_input import TableFile

TABLE = pd.DataFrame({"a": [1, 2, 3], "b": ["x", None, "z"], "c": 0.5})


def written(folder: Path, name: str, table: pd.DataFrame = TABLE) -> Path:
    if name.endswith("csv"):
        table.to_csv(folder / name, index=False)
    else:
        table.to_parquet(folder / name)
    return folder / name


@pytest.mark.parametrize(("name", "place"), [("t.csv", "line 3"), ("t.parquet", "row 2")])
def test_both_kinds_read_the_same(tmp_path: Path, name: str, place: str) -> None:
    source = TableFile.open(written(tmp_path, name))
    table = source.read(["b", "a"])
    assert source.columns == ("a", "b", "c")
    assert table["a"].tolist() == [1, 2, 3]
    assert table["b"].isna().tolist() == [False, True, False]
    assert source.place(table["row"].iloc[1]) == f"{tmp_path / name}: {place}"
    word, number = place.split()
    assert source.place(*table["row"].iloc[1:]).endswith(f": {word}s {number} and {int(number) + 1}")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_empty_lines_are_no_rows_but_count_as_lines(tmp_path: Path, end: str) -> None:
    (tmp_path / "t.csv").write_bytes(end.join(["", "a,b", "1,2", "", "", "3,4", "5,6"]).encode())
    source = TableFile.open(tmp_path / "t.csv")
    table = source.read(["a"])
    assert table["a"].tolist() == [1, 3, 5]
    assert source.place(*table["row"]) == f"{tmp_path / 't.csv'}: lines 3 and 6 and 7"


@pytest.mark.parametrize("name", ["t.csv", "t.parquet"])
def test_what_is_missing(tmp_path: Path, name: str) -> None:
    source = TableFile.open(written(tmp_path, name))
    with pytest.raises(InputError, match=r"columns \['d'\] are missing; the file has \['a', 'b', 'c'\]"):
        source.read(["a", "d"])
    with pytest.raises(InputError, match=r"columns \['d'\] of the mapping are missing"):
        source.read(["a", "d"], whose="of the mapping")
    empty = TableFile.open(written(tmp_path, name, TABLE.iloc[:0]))
    with pytest.raises(InputError, match="holds no rows"):
        empty.read(["a"])
    assert list(empty.read(["a"], may_be_empty=True).columns) == ["a", "row"]


def test_what_is_neither(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        TableFile.open(tmp_path / "absent.csv")
    (tmp_path / "t.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="not readable as CSV or Parquet"):
        TableFile.open(tmp_path / "t.parquet")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a,b,c\n1,2,3\n1,2\n", r"t.csv: line 3: 2 cells, expected 3 as in the first line"),
        (b"a,b,c\n" + b"1,2,3\n" * 200_000 + b"1,2,3,4\n", r"t.csv: line 200002: 4 cells, expected 3"),
        (b"a,b,c\n1,V\xe9lo,3\n", r"t.csv: line 2: not UTF-8: invalid continuation byte b'\\xe9'"),
        (b"a;b;c\n1;2;3\n1;2\n", r"t.csv: line 3: 2 cells, expected 3 as in the first line"),
        (b"", "Empty CSV file"),
    ],
)
def test_what_is_wrong_in_a_csv_file_is_told_by_its_line(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "t.csv").write_bytes(content)
    with pytest.raises(InputError, match=said):
        TableFile.open(tmp_path / "t.csv").read(["a", "b", "c"])


@pytest.mark.parametrize("separator", [";", "\t", "|"])
def test_other_separators_are_told_by_the_first_line(tmp_path: Path, separator: str) -> None:
    TABLE.to_csv(tmp_path / "t.csv", index=False, sep=separator)
    table = TableFile.open(tmp_path / "t.csv").read(["a", "b", "c"])
    pd.testing.assert_frame_equal(table[["a", "b", "c"]], TABLE, check_dtype=False)


@pytest.mark.parametrize("name", ["t.csv.gz", "t.parquet"])
def test_a_small_file_that_unpacks_to_a_large_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    path, rows = tmp_path / name, 10**6
    if name == "t.parquet":
        pd.DataFrame({"a": np.zeros(rows), "b": 1.0}).to_parquet(path)
    else:
        path.write_bytes(gzip.compress(b"a,b\n" + b"0,1\n" * rows))
    assert len(TableFile.open(path).read(["a", "b"])) == rows
    monkeypatch.setattr(input_files, "UNPACKED_MIN", 10**6)
    with pytest.raises(InputError, match=f"{name}: unpacks .*expected") as error:
        TableFile.open(path).read(["a", "b"])
    assert "\n" not in str(error.value)


def test_lines_of_packed_files_are_those_of_their_content(tmp_path: Path) -> None:
    path = tmp_path / "t.csv.gz"
    path.write_bytes(gzip.compress(b"a,b\n" + b"1,2\n" * 300))
    table = TableFile.open(path)
    assert len(table.read(["a", "b"])) == 300 and table.place(250) == f"{path}: line 250"
    path.write_bytes(gzip.compress(b"a,b\n" + b"1,2\n" * 300 + b"1,2,3\n"))
    with pytest.raises(InputError, match="line 302: 3 cells, expected 2"):
        TableFile.open(path).read(["a", "b"])


def test_arrow_files_are_known_as_such(tmp_path: Path) -> None:
    pd.DataFrame({"a": [1, 2]}).to_feather(tmp_path / "t.feather")
    with pytest.raises(InputError, match=r"t\.feather: is an Arrow file \(Feather\), expected CSV or Parquet"):
        TableFile.open(tmp_path / "t.feather")
