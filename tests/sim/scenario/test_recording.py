"""Recordings survive the disk unchanged, and what is no sound recording is refused with its place named."""

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from damage import REFUSED, SAME, damages, outcomes
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.io.parquet_input import parse_arrow
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import CHECK_KEY, COLUMNS, HEADER_KEY, Recording, RecordingHeader

HEADER = RecordingHeader("made", source="a test", licence="none", net="us101.net.xml", notes={"seed": 3})


def table_of(tracks: list[tuple[int, int, int]], seed: int = 0) -> pd.DataFrame:
    """Rows of (vehicle, first frame, frames) tracks with arbitrary values inside the bounds."""
    rng = np.random.default_rng(seed)
    rows = [(vehicle, first + k) for vehicle, first, count in tracks for k in range(count)]
    n = len(rows)
    return pd.DataFrame(
        {
            "vehicle_id": [vehicle for vehicle, _ in rows],
            "frame": [frame for _, frame in rows],
            "x": rng.normal(0.0, 1e3, n),
            "y": rng.normal(0.0, 1e3, n),
            "yaw": rng.uniform(-np.pi, np.pi, n),
            "speed": rng.uniform(0.0, 40.0, n),
            "acceleration": rng.normal(0.0, 2.0, n),
            "length": rng.uniform(2.0, 20.0, n),
            "width": rng.uniform(0.6, 2.6, n),
            "kind": rng.choice([int(kind) for kind in Kind], n),
            "lane": rng.integers(-1, 8, n),
        }
    )


def refusal(table: pd.DataFrame, header: RecordingHeader = HEADER) -> str:
    with pytest.raises(InputError) as caught:
        Recording.from_table(header, table, "FILE")
    assert str(caught.value).startswith("FILE: ")
    return str(caught.value)


tracks_strategy = st.lists(
    st.tuples(st.integers(1, 2**40), st.integers(-5, 10**6), st.integers(1, 8)),
    min_size=1,
    max_size=6,
    unique_by=lambda track: track[0],
)


@settings(max_examples=40, deadline=None)
@given(tracks=tracks_strategy, seed=st.integers(0, 2**32 - 1))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, tracks: list[tuple[int, int, int]], seed: int) -> None:
    path = tmp_path_factory.mktemp("recording") / "deep" / "a.parquet"
    made = Recording.from_table(HEADER, table_of(tracks, seed), "made")
    made.write(path)
    read = Recording.read(path)
    assert read.header == HEADER
    pd.testing.assert_frame_equal(read.table, made.table, check_exact=True)
    assert {name: str(dtype) for name, dtype in read.table.dtypes.items()} == COLUMNS


@settings(max_examples=20, deadline=None)
@given(order=st.permutations(range(9)))
def test_order_of_rows_and_columns_does_not_matter(order: list[int]) -> None:
    table = table_of([(5, 10, 4), (2, 12, 5)])
    usual = Recording.from_table(HEADER, table, "made").table
    other = Recording.from_table(HEADER, table.iloc[order][list(reversed(table.columns))], "made").table
    pd.testing.assert_frame_equal(usual, other, check_exact=True)
    assert list(zip(usual["frame"], usual["vehicle_id"], strict=True)) == sorted(
        zip(table["frame"], table["vehicle_id"], strict=True)
    )


@pytest.mark.parametrize("column", [name for name, dtype in COLUMNS.items() if dtype == "float64"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(column: str, value: float) -> None:
    table = table_of([(7, 100, 5)])
    table.loc[3, column] = value
    assert f"row 4 (vehicle_id 7, frame 103): column {column} is {value}" in refusal(table)


@pytest.mark.parametrize(
    ("column", "value"),
    [("speed", 120.0), ("speed", -0.1), ("length", 60.0), ("width", 8.5), ("yaw", 90.0), ("kind", 300)],
)
def test_values_in_a_wrong_unit(column: str, value: float) -> None:
    table = table_of([(7, 100, 5)])
    table.loc[2, column] = value
    assert f"column {column} is {value}" in refusal(table)


@pytest.mark.parametrize("column", ["vehicle_id", "frame", "lane"])
def test_fractions_where_whole_numbers_belong(column: str) -> None:
    table = table_of([(7, 100, 5)]).astype({column: float})
    table.loc[1, column] += 0.5
    assert "expected a whole number" in refusal(table)


def test_words_where_numbers_belong() -> None:
    table = table_of([(7, 100, 5)]).astype({"x": object})
    table.loc[4, "x"] = "far"
    assert "column x is far, expected a finite number" in refusal(table)


def test_hole_in_a_track() -> None:
    table = table_of([(3, 0, 6), (4, 0, 6)])
    message = refusal(table[~((table["vehicle_id"] == 4) & (table["frame"] == 2))])
    assert "vehicle_id 4: frame 1 is followed by a hole (next row: frame 3)" in message


def test_doubled_row() -> None:
    table = table_of([(3, 0, 6)])
    assert "vehicle_id 3: frame 4 is duplicated" in refusal(pd.concat([table, table.iloc[[4]]]))


def test_unknown_missing_and_no_columns() -> None:
    table = table_of([(3, 0, 6)])
    assert "unknown columns ['colour']" in refusal(table.assign(colour=1))
    assert "missing columns ['yaw']" in refusal(table.drop(columns="yaw"))
    assert "no rows" in refusal(table.iloc[:0])


def test_another_rate() -> None:
    assert "rate_hz is 25.0, expected 10.0" in refusal(table_of([(3, 0, 6)]), RecordingHeader("fast", rate_hz=25.0))


def test_files_that_are_no_recordings(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        Recording.read(tmp_path / "absent.parquet")
    text = tmp_path / "text.parquet"
    text.write_text("not Parquet")
    with pytest.raises(InputError, match=r"text\.parquet: not a readable Parquet file"):
        Recording.read(text)
    plain = tmp_path / "plain.parquet"
    table_of([(3, 0, 6)]).to_parquet(plain)
    with pytest.raises(InputError, match="not a LitSim recording"):
        Recording.read(plain)


SHORT = pa.Table.from_pandas(table_of([(3, 0, 6)]), preserve_index=False)
ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.floats()
    | st.integers(-(10**320), 10**320)
    | st.sampled_from(["", "a", "x" * 10**5]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
"""Any value of JSON, and some that JSON does not have."""


@settings(max_examples=200, deadline=None)
@given(st.dictionaries(st.sampled_from([field.name for field in fields(RecordingHeader)]), ANYTHING), st.integers(0, 3))
def test_whatever_a_header_holds_it_is_used_or_refused_in_one_short_line(values: dict[str, Any], kept: int) -> None:
    usual = dict(list(asdict(HEADER).items())[: 2 * kept])  # so that only some fields are strange
    header = json.dumps(values | usual if kept else values).encode()
    try:
        recording = Recording.from_arrow(SHORT.replace_schema_metadata({HEADER_KEY: header}), "made")
    except InputError as error:
        text = str(error)
    else:
        text = ""
    if text:
        assert len(text) < 500 and "\n" not in text
        return
    assert isinstance(recording.header.name, str) and recording.header.rate_hz == 10.0
    again = parse_arrow(pa.BufferReader(recording.parquet), "made")
    assert Recording.from_arrow(again, "made").header.name == recording.header.name


@pytest.mark.parametrize(
    "header",
    [
        b"{",
        b"[1, 2]",
        b'{"source": "nameless"}',
        b"\xff\xfe",
        b"[" * 10**6,
        b'{"name": "deep", "notes": ' + b'{"a": ' * 10**5 + b"1" + b"}" * 10**5 + b"}",
        b'{"name": "a", "rate_hz": "10"}',
        b'{"name": "a", "notes": []}',
        b'{"name": 7}',
    ],
)
def test_malformed_headers(tmp_path: Path, header: bytes) -> None:
    path = tmp_path / "a.parquet"
    arrow = pa.Table.from_pandas(table_of([(3, 0, 6)]), preserve_index=False)
    pq.write_table(arrow.replace_schema_metadata({HEADER_KEY: header}), path)
    with pytest.raises(InputError, match="malformed header"):
        Recording.read(path)


def test_headers_of_later_versions_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    arrow = pa.Table.from_pandas(table_of([(3, 0, 6)]), preserve_index=False)
    header = json.dumps({"name": "later", "weather": "fair"}).encode()
    pq.write_table(arrow.replace_schema_metadata({HEADER_KEY: header}), path)
    assert Recording.read(path).header == RecordingHeader("later")


def test_a_file_that_is_damaged_is_refused_or_reads_the_same(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    Recording.from_table(HEADER, table_of([(5, 10, 40), (2, 12, 30)]), "made").write(path)

    def read(path: Path) -> tuple[RecordingHeader, bytes]:
        recording = load_recording(path)
        return recording.header, recording.table.to_csv().encode()

    found = outcomes(path, damages(path.read_bytes(), 600, 0), read, lambda _: False)
    refused = sum(number for (_, kind), number in found.items() if kind == REFUSED)
    same = sum(number for (_, kind), number in found.items() if kind == SAME)
    assert refused > same > 0  # much of a Parquet file's own metadata is not needed to read it


def test_a_value_that_differs_from_what_was_written_is_seen_and_older_files_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    Recording.from_table(HEADER, table_of([(5, 10, 4)]), "made").write(path)
    arrow = pq.read_table(path)
    metadata = dict(arrow.schema.metadata)
    speed = arrow.column("speed").to_numpy().copy()
    speed[2] = np.nextafter(speed[2], 0.0)
    other = arrow.set_column(arrow.column_names.index("speed"), "speed", pa.array(speed))
    pq.write_table(other.replace_schema_metadata(metadata), path)
    with pytest.raises(InputError, match=r"a\.parquet: damaged: its content does not match its checksum"):
        Recording.read(path)
    del metadata[CHECK_KEY]
    pq.write_table(other.replace_schema_metadata(metadata), path)
    assert Recording.read(path).table["speed"][2] == speed[2]


def test_a_file_of_other_types_and_orders_is_the_same_recording(tmp_path: Path) -> None:
    """Columns in the neutral types are read as they are, others by way of pandas; what follows is the same."""
    table = table_of([(3, 5, 4), (1, 4, 6)])
    recording = Recording.from_table(HEADER, table, "FILE")
    recording.write(tmp_path / "plain.parquet")
    metadata = pq.read_schema(tmp_path / "plain.parquet").metadata
    other = table.sample(frac=1.0, random_state=1)[[*reversed(COLUMNS)]].astype({"lane": "float64", "kind": "int64"})
    content = pa.Table.from_pandas(other, preserve_index=False).replace_schema_metadata(metadata)
    pq.write_table(content, tmp_path / "other.parquet")
    read = {name: Recording.read(tmp_path / f"{name}.parquet") for name in ("plain", "other")}
    for each in read.values():
        assert each.parquet == recording.parquet == (tmp_path / "plain.parquet").read_bytes()
        pd.testing.assert_frame_equal(each.table, recording.table)


def test_a_mask_takes_its_rows() -> None:
    recording = Recording.from_table(HEADER, table_of([(3, 5, 4), (1, 4, 6)]), "FILE")
    part = recording.take(recording.columns["vehicle_id"] == 3)
    assert part.header == HEADER
    assert part.columns["frame"].tolist() == [5, 6, 7, 8]
    pd.testing.assert_frame_equal(part.table, recording.table.query("vehicle_id == 3").reset_index(drop=True))
