"""Which rows of a file are taken; of each that is not, the count and the reason are kept."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import made_tables
from litsim_data.generic.convert import convert
from litsim_data.generic.counts import Counts
from litsim_data.generic.mapping import Mapping
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.recording import Recording

COLUMNS = {"vehicle_id": "track_id", "time": "timestamp", "x": "x", "y": "y", "length": 4.4, "width": 1.8}
FIELDS: dict[str, Any] = {"name": "made", "columns": COLUMNS, "reference": "box_centre"}

Traffic = Callable[..., pd.DataFrame]


@pytest.fixture
def converted(tmp_path: Path) -> Callable[..., tuple[Recording, Counts]]:
    def run(table: pd.DataFrame, name: str = "in.csv", **fields: Any) -> tuple[Recording, Counts]:
        return made_tables.converted(tmp_path / name, table, FIELDS | fields)

    return run


@pytest.mark.parametrize(
    ("rule", "left"),
    [
        (3, {3}),
        ("3", {3}),
        ([1, "4.0"], {1, 4}),
        ({"min": 2, "max": 4}, {2, 3, 4}),
        ({"max": 2.5}, {1, 2}),
    ],
)
def test_rows_are_filtered(converted: Callable[..., Any], traffic: Traffic, rule: Any, left: set[int]) -> None:
    recording, counts = converted(traffic(), rows={"track_id": rule})
    assert set(recording.table["vehicle_id"]) == left
    assert sum(counts.left_out.values()) == 300 * (5 - len(left))
    assert counts.read == 1500
    assert recording.header.notes["rows_left_out"] == counts.left_out


def test_a_filter_by_a_column_that_is_otherwise_not_used(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic().assign(sensor=lambda rows: rows["track_id"] % 2 == 1)
    recording, counts = converted(table, name="in.parquet", rows={"sensor": True})
    assert set(recording.table["vehicle_id"]) == {1, 3, 5}
    assert counts.left_out == {"sensor is not True": 600}
    with pytest.raises(InputError, match=r"rows\.sensor of the mapping keeps no row; the column holds True"):
        converted(table, rows={"sensor": "radar"})
    with pytest.raises(InputError, match=r"columns \['camera'\] of the mapping are missing"):
        converted(table, rows={"camera": 1})
    with pytest.raises(InputError, match=r"field rows\.agent_type: min and max are for numbers; the column holds car"):
        converted(table, rows={"agent_type": {"min": 1}})
    dated = table.assign(timestamp=pd.Timestamp("2024-05-17 08:30") + pd.to_timedelta(table["timestamp"], unit="s"))
    with pytest.raises(
        InputError, match=r"field rows\.timestamp: min and max are for numbers; the column holds 2024-05"
    ):
        converted(dated, rows={"timestamp": {"min": 5}})


@pytest.mark.parametrize(
    ("name", "rule"), [("in.csv", True), ("in.csv", "true"), ("in.parquet", "True"), ("in.parquet", ["TRUE"])]
)
def test_truth_is_the_same_quoted_or_not(converted: Callable[..., Any], traffic: Traffic, name: str, rule: Any) -> None:
    table = traffic().assign(valid=lambda rows: rows["track_id"] < 3)
    assert set(converted(table, name, rows={"valid": rule})[0].table["vehicle_id"]) == {1, 2}


def test_one_of_several_clips(converted: Callable[..., Any], traffic: Traffic) -> None:
    both = pd.concat([traffic().assign(case=1), traffic().assign(case=2, x=lambda rows: rows["x"] + 9.0)])
    with pytest.raises(InputError, match=r"occurs twice at 0.000 s, with other values; 1500 such .* columns.clip"):
        converted(both)
    clips = COLUMNS | {"clip": "case"}
    with pytest.raises(InputError, match=r"column 'case' has several clips, 1, 2; choose one by field clip"):
        converted(both, columns=clips)
    with pytest.raises(InputError, match=r"no clip 3 in column 'case', which has 1, 2"):
        converted(both, columns=clips, clip=3)
    recording, counts = converted(both, columns=clips, clip="2")
    assert recording.table["x"].min() == pytest.approx(109.0)
    assert counts.left_out == {"of another clip than 2": 1500}
    assert len(converted(traffic().assign(case=1), columns=clips)[0].table)


def test_kinds_may_be_dropped(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    table.loc[table["track_id"] == 2, "agent_type"] = "pedestrian"
    kinds = {"car": "car", "pedestrian": "drop"}
    recording, counts = converted(table, columns=COLUMNS | {"kind": "agent_type"}, kinds=kinds)
    assert set(recording.table["vehicle_id"]) == {1, 3, 4, 5}
    assert set(recording.table["kind"]) == {Kind.CAR}
    assert counts.left_out == {"kind pedestrian": 300}
    with pytest.raises(InputError, match="field kinds of the mapping drops every row"):
        converted(table, columns=COLUMNS | {"kind": "agent_type"}, kinds=dict.fromkeys(kinds, "drop"))


def test_copies_are_taken_once_and_counted(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    recording, counts = converted(pd.concat([table, table.iloc[:7]]))
    assert counts.left_out == {"exact copy of another": 7}
    pd.testing.assert_frame_equal(recording.table, converted(table)[0].table)


def test_what_resampling_leaves_out_is_counted(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    brief = table[table["track_id"] == 1].iloc[1:3].assign(track_id=9)  # from 0.04 to 0.08 s: between two frames
    _, counts = converted(pd.concat([table, brief]))
    assert (counts.tracks, counts.pieces, counts.too_short) == (6, 6, 1)
    assert "1 of them left out: seen between two frames of 10 Hz only" in counts.text()
    gap = table[(table["track_id"] != 1) | ~table["timestamp"].between(4.0, 6.0)]
    _, counts = converted(gap)
    assert (counts.tracks, counts.pieces) == (5, 6)
    assert "5, 6 after long holes were cut" in counts.text()


def test_rows_elsewhere_are_left_out(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    table.loc[[100, 101, 450], "x"] += 500.0
    recording, counts = converted(table)
    assert counts.left_out == {"the vehicle jumps elsewhere for less than half a second": 3}
    assert (counts.pieces, counts.jumps) == (5, 0)
    right = converted(traffic())[0].table
    assert np.abs(recording.table["x"] - right["x"]).max() < 0.1  # interpolated over the hole


def test_tracks_are_cut_where_the_vehicle_is_another_one(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    table.loc[(table["track_id"] == 2) & (table["timestamp"] > 5.0), "x"] += 500.0
    recording, counts = converted(table)
    assert (counts.tracks, counts.pieces, counts.jumps) == (5, 6, 1)
    assert "5, 6 after long holes and 1 jumps were cut" in counts.text()
    assert recording.header.notes["jumps"] == 1
    for _, rows in recording.table.groupby("vehicle_id"):
        assert np.hypot(np.diff(rows["x"]), np.diff(rows["y"])).max() < 2.0


def test_a_clock_that_begins_anew_is_refused(converted: Callable[..., Any], traffic: Traffic) -> None:
    """Seconds of the day past midnight; in the order of the vehicles, and of the times."""
    table = traffic().assign(timestamp=lambda rows: (rows["timestamp"] + 86394.0) % 86400.0)
    for given in (table, table.sort_values("track_id").groupby("track_id").head(300)):
        with pytest.raises(
            InputError, match=r"line 152: the clock falls back by 86400\.0 s, while vehicle 1 drives on"
        ):
            converted(given)
    late = traffic().assign(timestamp=lambda rows: rows["timestamp"] + 100.0)  # a second pass, written first
    assert converted(pd.concat([late, traffic()]))[1].pieces == 10


def test_places_of_absent_vehicles_are_refused(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    absent = table["timestamp"] > 2.0 + table["track_id"]
    table.loc[absent, ["x", "y"]] = 0.0
    with pytest.raises(
        InputError, match=r"line \d+: 5 vehicles jump to one place, \(0, 0\) in frame map, .* in 845 rows"
    ):
        converted(table)
    assert converted(table, rows={"x": {"min": 0.001}})[0].table["vehicle_id"].nunique() == 5


@pytest.mark.parametrize("shift", [3.0, -4.0])
def test_leaps_aside_are_told(converted: Callable[..., Any], traffic: Traffic, shift: float) -> None:
    table = traffic()
    table.loc[(table["track_id"] == 2) & (table["timestamp"] > 5.01), "y"] += shift
    recording, counts = converted(table)
    assert (counts.jumps, counts.notes["leaps"], counts.left_out) == (0, 1, {})
    lines = 2 + 300 + 125, 3 + 300 + 125  # of the head, and of the first vehicle's rows
    assert f"at most by {abs(shift):.1f} m within 0.04 s (" in counts.text()
    assert f"in.csv: lines {lines[0]} and {lines[1]})" in counts.text()
    assert recording.header.notes["leaps"] == 1
    table.loc[(table["track_id"] == 2) & (table["timestamp"] > 5.01), "y"] += shift
    with pytest.raises(InputError, match=rf"; 1 leaps, at most by .* \(.*in.csv: lines {lines[0]} and"):
        converted(table)


def test_what_vehicles_do_is_no_leap(converted: Callable[..., Any], traffic: Traffic) -> None:
    """One brakes to a stop with 10 m/s2, rows are missing, and tracks are cut and begin anew."""
    table = traffic()
    mine = table["track_id"] == 5
    angle = np.interp(table["timestamp"][mine], [0.0, 5.0, 6.0, 12.0], [0.0, 0.5, 0.55, 0.55])
    table.loc[mine, "x"], table.loc[mine, "y"] = 100.0 + 100.0 * np.sin(angle), 20.0 - 100.0 * np.cos(angle)
    table.loc[mine, "heading"] = angle
    table.loc[(table["track_id"] == 2) & (table["timestamp"] > 5.0), "x"] += 500.0
    held = table[~table["timestamp"].between(3.0, 3.4)]
    _, counts = converted(held, columns={name: each for name, each in COLUMNS.items() if name != "speed"})
    assert counts.jumps == 1
    assert "leaps" not in counts.text()


def test_vehicles_of_unknown_kind_are_told(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    table.loc[table["track_id"] < 3, "agent_type"] = "tram"
    columns = COLUMNS | {"kind": "agent_type"}
    _, counts = converted(table, columns=columns, kinds={"car": "car", "tram": "unknown"})
    assert "unknown    2 vehicles are of a kind that field kinds of the mapping calls unknown: tram 2" in counts.text()
    _, counts = converted(table, columns=columns, kinds={"car": "car", "tram": "truck"})
    assert "unknown" not in counts.text()


def test_kinds_that_are_missing_are_written_for_the_user(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    table.loc[table["track_id"] == 3, "agent_type"] = "truck_bus"
    columns = COLUMNS | {"kind": "agent_type"}
    said = (
        r"in.csv: line 2: kind 'car' is not in field kinds of the mapping, which needs an entry for each value of "
        r"column 'agent_type', one of car, truck, .*: for those that are missing, probably kinds: "
        r"\{'car': car, 'truck_bus': truck\}"
    )
    with pytest.raises(InputError, match=said):
        converted(table, columns=columns)
    with pytest.raises(ValueError, match=r"kinds without columns\.kind"):
        converted(table, kinds={"car": "car"})


def test_ids_that_vehicles_share_are_refused(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    table.loc[(table["track_id"] == 1) & (table.index % 10 == 5), "x"] += 500.0
    said = r"in.csv: lines 6 and 7: vehicle 1 moves by 500\.\d m within 0.04 s; 60 such jumps: does every vehicle"
    with pytest.raises(InputError, match=said):
        converted(table)


def test_kinds_are_told_of_cells_that_are_empty_and_of_numbers(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic().assign(agent_type=lambda rows: rows["track_id"].where(rows["track_id"] < 5))  # 1.0 to 4.0, empty
    columns, kinds = COLUMNS | {"kind": "agent_type"}, {"1": "car", "2": "truck", "3": "car", "4": "drop"}
    with pytest.raises(InputError, match=r"in.csv: line 1202: kind '' is not in field kinds of the mapping"):
        converted(table, columns=columns, kinds=kinds)
    recording, _ = converted(table, columns=columns, kinds=kinds | {"": "unknown"})
    assert set(recording.table["kind"]) == {Kind.CAR, Kind.TRUCK, Kind.UNKNOWN}


def test_a_place_in_a_parquet_file_is_a_row(converted: Callable[..., Any], traffic: Traffic) -> None:
    table = traffic()
    table.loc[10, "x"] = None
    with pytest.raises(InputError, match=r"in\.parquet: row 11: column 'x' is empty or nan, expected a number; 1 such"):
        converted(table, name="in.parquet")


def test_columns_with_the_same_name(tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text("track_id,timestamp,x,x,y\n1,0.0,1,2,3\n")
    with pytest.raises(InputError, match=r"several columns are called \['x'\]"):
        convert(tmp_path / "in.csv", Mapping.model_validate(FIELDS))


# A second file with a row for each vehicle


META = {"vehicles": {"file": "meta.csv", "vehicle_id": "id"}}


def meta() -> pd.DataFrame:
    classes = ["car", "truck_bus", "car", "car", "pedestrian"]
    return pd.DataFrame(
        {"id": [1.0, 2.0, 3.0, 4.0, 5.0], "long": [4.0, 12.0, 4.2, 4.4, 0.0], "kind": classes, "x": 9.0}
    )


def test_classes_and_sizes_of_a_second_file(
    tmp_path: Path, traffic: Traffic, converted: Callable[..., tuple[Recording, Counts]]
) -> None:
    """What the table has comes from there, though the second file has such a column as well."""
    columns = COLUMNS | {"length": "long", "kind": "kind"}
    kinds = {"car": "car", "truck_bus": "truck", "pedestrian": "drop"}
    meta().sample(frac=1.0, random_state=3).to_csv(tmp_path / "meta.csv", index=False)
    recording, counts = converted(traffic(), columns=columns, kinds=kinds, rows={"long": {"max": 13.0}}, **META)
    first = recording.table.groupby("vehicle_id")[["length", "kind"]].first()
    assert first["length"].to_dict() == {1: 4.0, 2: 12.0, 3: 4.2, 4: 4.4}
    assert first["kind"].to_dict() == {1: Kind.CAR, 2: Kind.TRUCK, 3: Kind.CAR, 4: Kind.CAR}
    assert counts.left_out == {"kind pedestrian": 300}
    plain, _ = converted(traffic()[lambda rows: rows["track_id"] < 5])
    pd.testing.assert_series_equal(recording.table["x"], plain.table["x"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table[table["id"] != 4], r"line 902: vehicle 4 is not in .*meta\.csv; 1 such vehicles"),
        (lambda table: pd.concat([table, table[:1]]), r"meta\.csv: line 7: vehicle 1 occurs a second time"),
        (
            lambda table: table.drop(columns="long"),
            r"meta\.csv: columns \['long'\] of the mapping, field vehicles, are",
        ),
        (
            lambda table: table.rename(columns={"id": "nr"}),
            r"meta\.csv: columns \['id'\] of the mapping, field vehicles",
        ),
    ],
)
def test_second_files_that_do_not_fit(
    tmp_path: Path,
    traffic: Traffic,
    converted: Callable[..., tuple[Recording, Counts]],
    change: Callable[[pd.DataFrame], pd.DataFrame],
    message: str,
) -> None:
    change(meta()).to_csv(tmp_path / "meta.csv", index=False)
    with pytest.raises(InputError, match=message):
        converted(traffic(), columns=COLUMNS | {"length": "long"}, **META)
