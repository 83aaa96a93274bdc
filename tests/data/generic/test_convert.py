"""Any CSV or Parquet becomes a recording by a mapping: reference points, units, angles, rates, ids."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from litsim_data.generic.convert import convert
from litsim_data.generic.mapping import Mapping
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.recording import Recording
from made_tables import converted, written

FRONT: dict[str, Any] = {
    "name": "made",
    "columns": {"vehicle_id": "id", "frame": "n", "x": "px", "y": "py", "length": 4.0, "width": 1.8},
    "reference": "front_centre",
}
BOX: dict[str, Any] = {
    "name": "made",
    "columns": {"vehicle_id": "id", "time": "t", "x": "px", "y": "py", "length": "l", "width": "w", "yaw": "h"},
    "reference": "box_centre",
}


def straight(rate: float = 10.0, seconds: float = 3.0, speed: float = 12.0, angle: float = 0.3) -> pd.DataFrame:
    """One vehicle that drives straight on, in SI units and mathematical angles."""
    n = np.arange(round(seconds * rate) + 1)
    gone = speed * n / rate
    return pd.DataFrame(
        {
            "id": "truck 7",
            "n": n,
            "t": n / rate,
            "px": 5.0 + gone * np.cos(angle),
            "py": 3.0 + gone * np.sin(angle),
            "h": angle,
            "l": 9.0,
            "w": 2.5,
            "v": speed,
        }
    )


def made(tmp_path: Path, table: pd.DataFrame, fields: dict[str, Any], name: str = "in.csv") -> Recording:
    return converted(tmp_path / name, table, fields)[0]


def told(tmp_path: Path, table: pd.DataFrame, fields: dict[str, Any]) -> str:
    """What a conversion has to tell."""
    return converted(tmp_path / "in.csv", table, fields)[1].text()


# What comes out


def test_front_centres_become_box_centres(tmp_path: Path) -> None:
    table = made(tmp_path, straight(), FRONT).table
    assert len(table) == 31
    np.testing.assert_allclose(table["yaw"], 0.3, atol=1e-9)
    np.testing.assert_allclose(table["x"].iloc[0], 5.0 - 2.0 * np.cos(0.3))
    np.testing.assert_allclose(table["y"].iloc[0], 3.0 - 2.0 * np.sin(0.3))
    np.testing.assert_allclose(table["speed"], 12.0)
    np.testing.assert_allclose(table["acceleration"], 0.0, atol=1e-9)
    assert set(table["kind"]) == {Kind.UNKNOWN}
    assert set(table["lane"]) == {-1}


@pytest.mark.parametrize("name", ["in.csv", "in.parquet"])
def test_box_centres_stay(tmp_path: Path, name: str) -> None:
    recording = made(tmp_path, straight(), BOX, name)
    table = recording.table
    np.testing.assert_allclose(table["x"].iloc[0], 5.0)
    np.testing.assert_allclose(table["length"], 9.0)
    assert recording.header.notes["ids"] == {"truck 7": 1}


def test_rear_axles_and_corners_become_box_centres(tmp_path: Path) -> None:
    right, source = made(tmp_path, straight(), BOX).table, straight()
    back = 0.29 * 9.0
    axle = source.assign(px=source["px"] - back * np.cos(0.3), py=source["py"] - back * np.sin(0.3))
    pd.testing.assert_frame_equal(made(tmp_path, axle, BOX | {"reference": "rear_axle"}).table, right, atol=1e-9)
    corner = straight(angle=np.pi).assign(px=lambda rows: rows["px"] - 4.5, py=lambda rows: -rows["py"] - 1.25)
    fields = BOX | {"reference": "box_corner", "transform": {"mirror_y": True, "yaw_deg": 0.0}}
    table = made(tmp_path, corner, fields).table
    np.testing.assert_allclose(table[["x", "y"]].iloc[0], [5.0, 3.0], atol=1e-9)
    with pytest.raises(InputError, match=r"20 degrees off the file's x axis in 100% of .* reference box_corner"):
        made(tmp_path, straight(angle=1.0), BOX | {"reference": "box_corner"})


def test_speeds_by_their_components(tmp_path: Path) -> None:
    columns = BOX["columns"] | {"speed": ["vx", "vy"]}
    source = straight().assign(vx=43.2 * np.cos(0.3), vy=43.2 * np.sin(0.3))
    table = made(tmp_path, source, BOX | {"columns": columns, "units": {"speed": "km/h"}}).table
    np.testing.assert_allclose(table["speed"], 12.0)
    with pytest.raises(InputError, match=r"line 9: column 'vy' is empty or nan, .*; without field columns\.speed"):
        made(tmp_path, source.assign(vy=lambda rows: rows["vy"].where(rows["n"] != 7)), BOX | {"columns": columns})


@pytest.mark.parametrize("rate", [5.0, 25.0, 29.97])
def test_other_rates_are_brought_to_10_hz(tmp_path: Path, rate: float) -> None:
    table = made(tmp_path, straight(rate), FRONT | {"rate_hz": rate}).table
    assert table["frame"].diff().dropna().eq(1).all()
    np.testing.assert_allclose(np.hypot(np.diff(table["x"]), np.diff(table["y"])), 1.2, atol=1e-6)


def test_frame_numbers_at_10_hz_stay(tmp_path: Path) -> None:
    source = straight()
    source["n"] += 4000
    assert made(tmp_path, source, FRONT).table["frame"].tolist() == list(range(4000, 4031))


def test_transform_and_mirror(tmp_path: Path) -> None:
    """A picture's axes (y down) become a right-handed frame; then a quarter turn and a shift."""
    transform = {"yaw_deg": 90.0, "x": 100.0, "y": 10.0, "mirror_y": True}
    table = made(tmp_path, straight(), BOX | {"transform": transform}).table
    np.testing.assert_allclose(table["yaw"], np.pi / 2 - 0.3, atol=1e-9)
    np.testing.assert_allclose((table["x"].iloc[0], table["y"].iloc[0]), (100.0 + 3.0, 10.0 + 5.0))
    motion = np.arctan2(np.diff(table["y"]), np.diff(table["x"]))
    np.testing.assert_allclose(motion, np.pi / 2 - 0.3, atol=1e-9)


def test_kinds_and_lanes(tmp_path: Path) -> None:
    source = straight().assign(k="van", lane=2)
    columns = FRONT["columns"] | {"kind": "k", "lane": "lane"}
    table = made(tmp_path, source, FRONT | {"columns": columns, "kinds": {"van": "truck"}}).table
    assert set(table["kind"]) == {Kind.TRUCK}
    assert set(table["lane"]) == {2}
    with pytest.raises(InputError, match="line 2: kind 'van' is not in field kinds of the mapping"):
        made(tmp_path, source, FRONT | {"columns": columns})


def test_lanes_are_those_of_the_nearest_rows(tmp_path: Path) -> None:
    table = straight(rate=2.0, seconds=2.0).assign(lane=[1, 1, 2, 2, 2])
    fields = BOX | {"columns": {**BOX["columns"], "lane": "lane"}}
    assert made(tmp_path, table, fields).table["lane"].tolist() == 8 * [1] + 13 * [2]


def test_what_a_mapping_leaves_open_is_told(tmp_path: Path) -> None:
    table = pd.concat([straight(), straight().assign(id="car 1", py=20.0, h=0.0, px=np.arange(31) * 1.2)])
    table = table.assign(what=table["id"].str[:-2])
    said = told(tmp_path, table, FRONT)
    assert "unknown    2 vehicles, as the mapping has no field columns.kind" in said and "size of all" not in said
    known = {"columns": FRONT["columns"] | {"kind": "what"}, "kinds": {"truck": "truck", "car": "car"}}
    said = told(tmp_path, table, FRONT | known)
    assert "unknown" not in said and "sizes      1 trucks or motorcycles have the size of all vehicles" in said


def test_a_track_is_what_most_of_its_rows_say(tmp_path: Path) -> None:
    table = pd.concat([straight(), straight().assign(n=lambda rows: rows["n"] + 100)], ignore_index=True)
    table["what"] = ["unsure"] * 3 + ["truck"] * 26 + ["walker"] * 2 + ["unsure"] + ["car"] * 30
    kinds = {"truck": "truck", "walker": "drop", "car": "car", "unsure": "unknown"}
    mapping = FRONT | {"columns": FRONT["columns"] | {"kind": "what"}, "kinds": kinds}
    recording, counts = converted(tmp_path / "in.csv", table.sample(frac=1.0, random_state=1), mapping)
    tracks = recording.table.groupby("vehicle_id")["kind"]
    assert tracks.unique().map(list).tolist() == [[Kind.TRUCK], [Kind.CAR]], "an id that is used again is another track"
    assert tracks.size().tolist() == [31, 31]
    assert "kinds      2 tracks change their kind" in counts.text() and not counts.left_out
    assert "unknown" not in counts.text()

    table.loc[:20, "what"] = "walker"
    counts = converted(tmp_path / "in.csv", table, mapping)[1]
    assert counts.left_out == {"kind walker": 23, "of a track most of whose rows are dropped": 8}


def test_a_vehicle_that_is_there_twice_is_told(tmp_path: Path) -> None:
    table = pd.concat([straight(), straight().assign(id="truck 8", px=lambda rows: rows["px"] + 1.0)])
    said = "overlaps   1 pairs of vehicles overlap for a second or more, above all 1 and 2 for 3.1 s"
    assert said in told(tmp_path, table, BOX)
    beside = table.assign(py=table["py"].where(table["id"] == "truck 7", table["py"] + 3.0))
    assert "overlaps" not in told(tmp_path, beside, BOX)


def test_headings_that_turn_as_none_does_are_told(tmp_path: Path) -> None:
    table = straight(seconds=30.0)
    assert "turns" not in told(tmp_path, table, BOX)
    table.loc[7, "h"] += np.pi
    said = told(tmp_path, table, BOX)
    assert "turns      2 times" in said and "by 180 degrees within 0.1 s" in said and "lines 8 and 9" in said


def test_short_holes_are_filled_long_ones_split(tmp_path: Path) -> None:
    source = straight(seconds=6.0)
    table = made(tmp_path, source[~source["n"].isin([10, 11, *range(30, 45)])], FRONT).table
    counts = table.groupby("vehicle_id").size()
    assert counts.tolist() == [30, 16]
    assert counts.index.tolist() == [1, 1_000_001]


def test_small_whole_ids_stay_others_are_counted(tmp_path: Path) -> None:
    two = pd.concat([straight().assign(id=17), straight().assign(id=5, px=60.0)])
    assert sorted(set(made(tmp_path, two, FRONT).table["vehicle_id"])) == [5, 17]
    two["id"] = two["id"] * 10**9
    recording = made(tmp_path, two, FRONT)
    assert sorted(set(recording.table["vehicle_id"])) == [1, 2]
    assert recording.header.notes["ids"] == {"17000000000": 1, "5000000000": 2}


def test_ids_that_are_no_numbers_leave_the_others_alone(tmp_path: Path) -> None:
    ids = ["88", "P1", "5", "P2", "005", "-1"]
    rows = [straight().assign(id=name, px=lambda table, k=k: table["px"] + 30.0 * k) for k, name in enumerate(ids)]
    recording = made(tmp_path, pd.concat(rows), FRONT)
    renumbered = {"P1": 89, "P2": 90, "005": 91, "-1": 92}
    assert recording.header.notes["ids"] == renumbered
    begins = recording.table.drop_duplicates("vehicle_id").set_index("vehicle_id")["x"]
    order = begins.sort_values().index.tolist()
    assert order == [renumbered.get(name) or int(name) for name in ids]
    rows[0]["id"] = "999999"
    with pytest.raises(InputError, match=r"4 vehicles with ids that are not integers .* from 1000000: expected fewer"):
        made(tmp_path, pd.concat(rows), FRONT)


def test_noise_is_cleaned_unless_the_mapping_forbids_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    source = straight(seconds=8.0)
    source[["px", "py"]] += rng.normal(0.0, 0.1, (len(source), 2))
    rough = made(tmp_path, source, FRONT | {"clean": False}).table
    smooth = made(tmp_path, source, FRONT).table
    assert rough["acceleration"].abs().quantile(0.9) > 3.0
    assert smooth["acceleration"].abs().max() < 3.0
    assert np.hypot(smooth["x"] - rough["x"], smooth["y"] - rough["y"]).median() < 0.2


# What is refused


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"px": "twelve"}, r"in.csv: line 12: column 'px' is 'twelve', expected a number; 1 such rows"),
        ({"px": np.nan}, r"in.csv: line 12: column 'px' is empty or nan, expected a number"),
        ({"id": None}, r"in.csv: line 12: no vehicle id; 1 such rows"),
        ({"n": 9}, r"in.csv: lines 11 and 12: vehicle 1 occurs twice at 0.900 s, with other values; 1 such"),
    ],
)
def test_cells_that_cannot_be_used(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    source = straight().astype({"px": object})
    for column, value in change.items():
        source.loc[10, column] = value
    with pytest.raises(InputError, match=message):
        made(tmp_path, source, FRONT)


def test_columns_and_files_that_are_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"columns \['py'\] of the mapping are missing; the file has \['id', "):
        made(tmp_path, straight().drop(columns="py"), FRONT)
    with pytest.raises(InputError, match="no such file"):
        convert(tmp_path / "absent.csv", Mapping.model_validate(FRONT))
    with pytest.raises(InputError, match="holds no rows"):
        made(tmp_path, straight().iloc[:0], FRONT)
    (tmp_path / "odd.csv").write_text("id,n,px,py\n1,2\n")
    with pytest.raises(InputError, match=r"odd.csv: line 2: 2 cells, expected 4 as in the first line"):
        convert(tmp_path / "odd.csv", Mapping.model_validate(FRONT))


def test_several_files_are_one_table(tmp_path: Path) -> None:
    """Vehicles and pedestrians apart, as INTERACTION has them: those have neither headings nor sizes."""
    driving = straight(seconds=2.0).assign(id=88, kind="car")
    later = straight(seconds=4.0).query("t > 2.05").assign(id=88, kind="car")
    walking = straight(speed=1.2).assign(id="P1", kind="pedestrian", px=60.0).drop(columns=["h", "l", "w"])
    paths = [tmp_path / name for name in ("a.csv", "b.csv", "walking.csv")]
    columns = {**BOX["columns"], "kind": "kind"}
    mapping = Mapping.model_validate({**BOX, "columns": columns, "kinds": {"car": "car", "pedestrian": "pedestrian"}})

    def convert_all() -> Recording:
        for path, table in zip(paths, (driving, later, walking), strict=True):
            written(path, table)
        return convert(paths, mapping)[0]

    recording = convert_all()
    assert recording.table.groupby("vehicle_id").size().to_dict() == {88: 41, 89: 31}
    assert recording.header.notes["file"] == "a.csv, b.csv, walking.csv"
    whole = written(tmp_path / "whole.csv", pd.concat([driving, later, walking]))
    pd.testing.assert_frame_equal(convert(whole, mapping)[0].table, recording.table)
    later["l"] = later["l"].astype(object)
    later.iloc[3, later.columns.get_loc("l")] = "long"
    with pytest.raises(InputError, match=r"b\.csv: line 5: column 'l' is 'long'"):
        convert_all()
    later = straight(seconds=4.0).query("t > 1.95").assign(id=88, kind="car", px=7.0)
    with pytest.raises(InputError, match=r"a\.csv: line 22 and .*b\.csv: line 2: vehicle 88 occurs twice at 2\.000 s"):
        convert_all()
    walking = walking.drop(columns="px")
    with pytest.raises(InputError, match=r"walking\.csv: columns \['px'\] of the mapping are missing"):
        convert_all()
    with pytest.raises(InputError, match=r"a\.csv: is given twice"):
        convert([paths[0], paths[0]], mapping)


def test_times_that_no_frame_falls_into(tmp_path: Path) -> None:
    late = straight(seconds=1.0).assign(t=lambda table: table["t"] + 0.1)
    with pytest.raises(InputError, match=r"in\.csv: no vehicle is seen at a frame of 10 Hz"):
        made(tmp_path, late, BOX | {"units": {"time": "ms"}, "accept": ["time"]})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"reference": "rear"},
            "reference: Input should be 'front_centre', 'box_centre', 'rear_axle', 'rear_centre' or",
        ),
        ({"colour": 1}, "colour: Extra inputs are not permitted"),
        ({"units": {"position": "yard"}}, "units.position: Input should be 'm', 'ft' or 'cm'"),
        ({"columns": {"vehicle_id": "id"}}, "columns.x: Field required"),
        ({"columns": FRONT["columns"] | {"time": "t"}}, "columns: give either frame or time"),
        (
            {"columns": FRONT["columns"] | {"y": "px"}},
            "columns: x and y are both column 'px', expected two",
        ),
        (
            {"columns": FRONT["columns"] | {"speed": ["v", "v"]}},
            "columns: speed_x and speed_y are both column 'v', expected two",
        ),
        ({"transform": {"x": float("nan")}}, "transform.x: Input should be a finite number, found nan"),
        (
            {"columns": FRONT["columns"] | {"speed": ["v"]}},
            "columns.speed: expected a column, or the two of its components, [vx, vy], found ['v']",
        ),
        *(
            (
                {"columns": FRONT["columns"] | {"length": size}},
                f"columns.length: expected a column, or a number greater than 0, found {size!r}$",
            )
            for size in ([1, 2], True, -4.5, 0)
        ),
        ({"rate_hz": 0}, "rate_hz: Input should be greater than 0"),
    ],
)
def test_mappings_with_defects(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = tmp_path / "mapping.yaml"
    path.write_text(yaml.safe_dump(FRONT))
    assert read_yaml(path, Mapping) == Mapping.model_validate(FRONT)
    path.write_text(yaml.safe_dump(FRONT | change))
    pattern = re.escape(message.removesuffix("$")) + "$" * message.endswith("$")
    with pytest.raises(InputError, match=rf"{re.escape(str(path))}: (line \d+, )?field {pattern}"):
        read_yaml(path, Mapping)


def test_the_documented_examples(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "docs" / "data.md").read_text(encoding="utf-8")
    front, box = (
        Mapping.model_validate(yaml.safe_load(block))
        for block in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
        if "reference: " in block
    )
    n = np.arange(60)
    source = pd.DataFrame({"Vehicle": 4, "Frame": n, "Along": 3.0 * n, "Left": 6.0, "Length": 15.0, "Width": 6.0})
    table = convert(written(tmp_path / "front.csv", source.assign(Class=2, Lane=1)), front)[0].table
    np.testing.assert_allclose(table["x"], 0.3048 * (3.0 * n - 7.5), atol=0.05)
    np.testing.assert_allclose(table["speed"], 9.144, atol=0.05)
    assert set(table["kind"]) == {Kind.CAR}
    source = pd.DataFrame({"trackId": 4, "frame": n, "xCenter": 0.4 * n, "yCenter": 2.0, "heading": 0.0, "v": 36.0})
    table = convert(written(tmp_path / "box.csv", source), box)[0].table
    np.testing.assert_allclose(table["x"], 252.0)
    np.testing.assert_allclose(table["y"], -30.0 + table["frame"])
    np.testing.assert_allclose(table["yaw"], np.pi / 2)
    np.testing.assert_allclose(table["speed"], 10.0)


# Clocks and speeds as files have them


@pytest.mark.parametrize("name", ["in.csv", "in.parquet"])
def test_dates_are_times(tmp_path: Path, name: str) -> None:
    """Dates with times of the day need no unit; no frame is lost to what seconds since 1970 are rounded to."""
    plain = made(tmp_path, straight(), BOX).table
    stamps = pd.Timestamp("2024-05-17T08:30:00") + pd.to_timedelta(straight()["t"], unit="s")
    for times in (stamps, stamps.dt.tz_localize("UTC"), stamps.astype("datetime64[ms]")):
        recording = made(tmp_path, straight().assign(t=times), BOX, name)
        pd.testing.assert_frame_equal(recording.table, plain, atol=1e-3, rtol=0.0)
        assert recording.header.notes["time_of_frame_0_s"] == pytest.approx(1715934600.0)
    with pytest.raises(InputError, match=r"(line 6|row 5): column 't' is empty or nan, expected a number; 1 such rows"):
        made(tmp_path, straight().assign(t=stamps.where(stamps.index != 4)), BOX, name)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ns", 1e9)])
def test_no_frame_is_lost_by_the_size_of_a_clock(tmp_path: Path, unit: str, factor: float) -> None:
    for begin in (0.0, 0.3, 0.7):
        late = straight().assign(t=lambda rows, begin=begin: np.round((1.7e9 + begin + rows["t"]) * factor, 1))
        table = made(tmp_path, late, BOX | {"units": {"time": unit}}).table
        assert len(table) == 31
        np.testing.assert_allclose(np.hypot(np.diff(table["x"]), np.diff(table["y"])), 1.2, atol=1e-4)


def test_who_reverses_has_no_speed(tmp_path: Path) -> None:
    fields = BOX | {"columns": BOX["columns"] | {"speed": "v"}, "clean": False}
    table = straight().assign(v=lambda rows: rows["v"].where(rows["n"] != 7, -0.02))
    recording, counts = converted(tmp_path / "in.csv", table, fields)
    assert recording.table["speed"].tolist() == pytest.approx([12.0] * 7 + [0.0] + [12.0] * 23)
    assert "speeds     1 rows below 0" in counts.text()
    assert recording.header.notes["rows_backwards"] == 1


def test_cells_that_a_file_need_not_have(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"column 'h' is empty or nan, .*; without field columns\.yaw it is derived from the mo"
    ):
        made(tmp_path, straight().assign(h=lambda rows: rows["h"].where(rows["n"] != 7)), BOX)
    some = BOX | {"rows": {"h": {"min": -1000}}}  # as the error says
    found = made(tmp_path, straight().assign(h=lambda rows: rows["h"].where(rows["n"] != 7)), some)
    assert len(found.table) == len(made(tmp_path, straight(), BOX).table)


# Noise


WITHOUT_YAW = {name: column for name, column in BOX["columns"].items() if name != "yaw"}


def waiting(noise: float) -> pd.DataFrame:
    """A car that drives 20 m northwards, and waits there for 20 s, at 10 Hz."""
    t = np.arange(0.0, 24.0, 0.1)
    rng = np.random.default_rng(4)
    x, y = rng.normal(0.0, noise, (2, len(t)))
    return pd.DataFrame({"id": 1, "t": t, "px": 50.0 + x, "py": np.minimum(5.0 * t, 20.0) + y, "l": 5.0, "w": 2.0})


def test_who_reverses_stays_where_it_was_or_is_told(tmp_path: Path) -> None:
    """One vehicle backs out 10 m; another does so for 7 m, and drives on."""
    t = np.arange(100) / 10.0
    backs = pd.DataFrame({"id": 1, "n": np.arange(100), "px": -1.0 * t, "py": 0.0, "h": 0.0, "l": 4.5, "w": 1.9})
    turns = backs.assign(id=2, px=np.where(t < 5, -1.5 * t, -7.5 + (t - 5.0) ** 2), py=20.0)
    drives = backs.assign(id=3, px=8.0 * t, py=40.0)
    columns = FRONT["columns"] | {"length": "l", "width": "w", "yaw": "h"}
    fields = {**FRONT, "columns": columns, "reference": "box_centre", "clean": True, "accept": ["heading"]}
    recording, counts = converted(tmp_path / "in.csv", pd.concat([backs, turns, drives]), fields)
    backed = recording.table[recording.table["vehicle_id"] == 1]
    np.testing.assert_allclose(backed["x"], backs["px"], atol=0.05)
    moved = recording.header.notes["moved_by_cleaning_m"]
    assert set(moved) == {"2"} and moved["2"] > 1.0  # type: ignore[call-overload, index]
    assert re.search(r"cleaned +1 vehicles are moved by more than 1 m, above all 2 by \d\.\d m", counts.text())


@pytest.mark.parametrize("reference", ["box_centre", "front_centre"])
@pytest.mark.parametrize("smooth", [True, False])
def test_who_waits_does_not_turn_by_noise(tmp_path: Path, reference: str, smooth: bool) -> None:
    fields = BOX | {"columns": WITHOUT_YAW, "reference": reference, "clean": smooth}
    table = made(tmp_path, waiting(0.15), fields).table
    stands = table[table["frame"] > 60]
    np.testing.assert_allclose(stands["yaw"], np.pi / 2, atol=0.3)
    middle = 20.0 if reference == "box_centre" else 17.5
    np.testing.assert_allclose(stands[["x", "y"]], np.broadcast_to([50.0, middle], (len(stands), 2)), atol=0.9)


@pytest.mark.parametrize(("noise", "clean", "said"), [(0.0, None, ""), (0.1, False, "rough "), (0.1, None, "noisy ")])
def test_noise_is_told(tmp_path: Path, noise: float, clean: bool | None, said: str) -> None:
    fields = BOX | {"columns": WITHOUT_YAW, "clean": clean}
    recording, counts = converted(tmp_path / "in.csv", waiting(noise), fields)
    assert [word for word in ("rough ", "noisy ") if word in counts.text()] == [said] * bool(said)
    assert ("noise" in recording.header.notes) == (said == "noisy ")


def test_impossible_motion_is_refused_where_it_must_not_be_cleaned(tmp_path: Path) -> None:
    fields = BOX | {"columns": WITHOUT_YAW}
    with pytest.raises(InputError, match=r"accelerations derived from the file reach .*: field clean of the map"):
        made(tmp_path, waiting(1.0), fields | {"clean": False})
    assert len(made(tmp_path, waiting(1.0), fields).table)


# What belongs together, and what is on another level


def tractor(turn: float = 0.0, gap: float = 0.4, drift: float = 0.0) -> pd.DataFrame:
    """A tractor with a trailer `gap` [m] behind, and a car 15 m ahead; in a bend with yaw rate `turn`, at 14 m/s."""
    t = np.arange(0.0, 8.0, 0.1)
    rows = []
    for name, length, back, slower in (("1", 4.6, -20.0, 0.0), ("2", 7.0, 0.0, 0.0), ("3", 13.0, 10.0 + gap, drift)):
        gone = (14.0 - slower) * t - back
        yaw = turn * gone / 14.0
        x = np.sin(yaw) * 14.0 / turn if turn else gone
        y = (1.0 - np.cos(yaw)) * 14.0 / turn if turn else 0.0 * gone
        rows.append(pd.DataFrame({"id": name, "t": t, "px": x, "py": y, "h": yaw, "l": length, "w": 2.5}))
    return pd.concat(rows, ignore_index=True)


@pytest.mark.parametrize("clean", [False, True])
def test_a_trailer_in_line_is_one_box_with_its_vehicle(tmp_path: Path, clean: bool) -> None:
    recording, counts = converted(tmp_path / "in.csv", tractor(), BOX | {"clean": clean})
    table = recording.table
    assert counts.notes["trailers_joined"] == {"3": 2} and set(table["vehicle_id"]) == {1, 2}
    assert "trailers   one box with the vehicle that tows them: 3 of 2" in counts.text()
    box = table[table["vehicle_id"] == 2]
    np.testing.assert_allclose(box["length"], 20.4)
    front = 14.0 * 0.1 * np.arange(80) + 3.5
    np.testing.assert_allclose(box["x"] + 10.2, front, atol=1e-6, err_msg="it stays where it was")


def test_a_trailer_that_turns_against_its_vehicle_is_told(tmp_path: Path) -> None:
    recording, counts = converted(tmp_path / "in.csv", tractor(turn=0.3), BOX)
    assert counts.notes["trailers_apart"] == {"3": 2} and set(recording.table["vehicle_id"]) == {1, 2, 3}
    assert "trailers   3 of 2: tracks of their own" in counts.text()


@pytest.mark.parametrize("apart", [{"gap": 3.0}, {"drift": 0.1}])
def test_vehicles_that_follow_each_other_are_no_trailers(apart: dict[str, float], tmp_path: Path) -> None:
    assert "trailers" not in told(tmp_path, tractor(**apart), BOX)


@pytest.mark.parametrize(("height", "apart"), [(7.0, True), (2.0, False)])
def test_vehicles_on_two_levels_are_told(height: float, apart: bool, tmp_path: Path) -> None:
    east = straight(angle=0.0, seconds=6.0).assign(id="1", z=0.0)
    north = straight(angle=0.5 * np.pi, seconds=6.0).assign(id="2", z=height)
    north = north.assign(px=41.0, py=north["py"] - 36.0)
    text = told(tmp_path, pd.concat([east, north]), BOX)
    line = f"levels     column 'z' spans {height:.1f} m and is not used, though 1 pairs of vehicles are near"
    assert (line in text) == apart
    assert ("rows: {z: {max: 3.0}}" in text) == apart
