"""A drafted mapping converts the file that it was drafted from."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from litsim_data.generic.convert import convert
from litsim_data.generic.draft import draft
from litsim_data.generic.mapping import Mapping
from litsim_sim.core.errors import InputError
from made_tables import written

Traffic = Callable[..., pd.DataFrame]
OPTIONAL = {"heading": "yaw", "speed": "speed"}


def mapping_of(text: str) -> Mapping:
    return Mapping.model_validate(yaml.safe_load(text))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "case.csv"


def drafted(path: Path, table: pd.DataFrame) -> Mapping:
    """What is drafted from a table, written to `path`."""
    return mapping_of(draft(written(path, table)))


def made_of(path: Path, table: pd.DataFrame) -> pd.DataFrame:
    """What the drafted mapping makes of a table, written to `path`."""
    return convert(path, drafted(path, table))[0].table


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, traffic: Traffic) -> pd.DataFrame:
    """What a drafted mapping makes of the traffic itself."""
    return made_of(tmp_path_factory.mktemp("plain") / "plain.csv", traffic())


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.assign(timestamp=(1000 * table["timestamp"]).round().astype(int)),
        lambda table: table.assign(heading=90.0 - np.rad2deg(table["heading"])),
        lambda table: table.assign(speed=3.6 * table["speed"], length=table["length"] / 0.3048, width=1.8 / 0.3048),
        lambda table: table.rename(
            columns={"timestamp": "timestamp_s", "heading": "psi_rad", "x": "xCenter", "y": "yCenter"}
        ),
        lambda table: table.assign(timestamp=(1e6 * table["timestamp"]).round().astype(int)).rename(
            columns={"timestamp": "timestamp_micros", "x": "center_x", "y": "center_y", "track_id": "object_id"}
        ),
        lambda table: (
            table.assign(timestamp=(1e9 * table["timestamp"]).round().astype(int), v=3.6 * table["speed"])
            .drop(columns="speed")
            .rename(columns={"track_id": "agent_uuid", "timestamp": "stamp_ns", "v": "speed_kph"})
        ),
        lambda table: table.assign(timestamp=(1e9 * table["timestamp"]).round().astype(int)).rename(
            columns={"track_id": "track_idx", "timestamp": "total_nanos", "x": "tx_m", "y": "ty_m"}
        ),
        lambda table: pd.concat(
            [table.assign(valid=True), table.assign(valid=False, x=-10000.0, y=-10000.0, heading=np.nan, speed=-1.0)]
        ),
        lambda table: table.assign(length=100.0 * table["length"], width=180.0).rename(
            columns={
                "heading": "Course_rad",
                "x": "Easting",
                "y": "Northing",
                "length": "Length_cm",
                "width": "Width_cm",
            }
        ),
    ],
)
def test_units_and_conventions_are_found(
    path: Path, traffic: Traffic, plain: pd.DataFrame, change: Callable[..., pd.DataFrame]
) -> None:
    made = made_of(path, change(traffic()))
    assert plain["speed"].max() == pytest.approx(11.0)
    pd.testing.assert_frame_equal(made, plain, atol=0.02, rtol=0.0)


@pytest.mark.parametrize(("unit", "factor"), [("km/h", 3.6), ("ft/s", 1.0 / 0.3048)])
def test_units_that_are_close_are_told_apart_in_noisy_positions(
    path: Path, traffic: Traffic, unit: str, factor: float
) -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.03, (2, 1500))  # 1 m/s from row to row at 25 Hz
    table = traffic(speed=factor).drop(columns="heading")
    slow = np.repeat(np.linspace(0.1, 1.0, 5), 300)  # times as fast, from car to car
    table["speed"] *= slow
    table["x"], table["y"] = (
        100.0 + (table[axis] - 100.0) * slow + each for axis, each in zip("xy", noise, strict=True)
    )
    mapping = drafted(path, table)
    assert mapping.units.speed == unit
    convert(path, mapping)
    other = mapping.units.model_copy(update={"speed": {"km/h": "ft/s", "ft/s": "km/h"}[unit]})
    with pytest.raises(InputError, match=rf"fastest quarter\); units.speed {unit} would fit better than {other.speed}"):
        convert(path, mapping.model_copy(update={"units": other}))


def test_columns_with_empty_cells_are_used_only_where_they_must_be(path: Path, traffic: Traffic) -> None:
    table = traffic().assign(lane=1.0)
    table.loc[[3, 700], ["heading", "lane"]] = np.nan
    made = made_of(path, table)
    assert "# heading has cells without a number, and is not used; lane has cells" in draft(path)
    assert len(made) == 5 * 120 and (made["lane"] == -1).all()


def test_people_need_no_headings(tmp_path: Path, traffic: Traffic) -> None:
    """As in INTERACTION, whose pedestrians are in a file of their own."""
    people = traffic().assign(agent_type="pedestrian/bicycle", track_id=lambda rows: "P" + rows["track_id"].astype(str))
    people = people.drop(columns=["heading", "length", "width"])
    files = [written(tmp_path / "vehicles.csv", traffic()), written(tmp_path / "people.csv", people)]
    mapping = mapping_of(draft(files))
    assert mapping.columns.yaw == "heading" and mapping.kinds == {"car": "car", "pedestrian/bicycle": "drop"}
    assert set(convert(files, mapping)[0].table["vehicle_id"]) == {1, 2, 3, 4, 5}


def test_kinds_clips_and_what_is_missing(path: Path, traffic: Traffic) -> None:
    table = pd.concat([traffic().assign(case_id=case) for case in (7, 8)])
    table.loc[table["track_id"] == 2, "agent_type"] = "pedestrian/bicycle"
    table.loc[table["track_id"] == 3, "agent_type"] = "truck"
    text = draft(written(path, table.drop(columns=["length", "width"]).assign(note="-")))
    mapping = mapping_of(text)
    assert mapping.kinds == {"car": "car", "pedestrian/bicycle": "drop", "truck": "truck"}
    assert mapping.clip == 7
    assert mapping.columns.length is mapping.columns.width is None
    assert "not used: note." in text.splitlines()[0]
    assert "the file has no length and width" in text
    sizes = convert(path, mapping)[0].table.groupby("vehicle_id")[["length", "width"]].first()
    assert sizes.to_numpy().tolist() == [[4.6, 1.9], [12.0, 2.5], [4.6, 1.9], [4.6, 1.9]]


def test_numbers_of_kinds_mean_what_ngsim_means_by_them_in_its_column_alone(path: Path, traffic: Traffic) -> None:
    table = traffic().assign(agent_type=lambda rows: rows["track_id"] % 3 + 1)
    assert drafted(path, table).kinds == dict.fromkeys("123", "unknown")  # of Waymo's, 2 is a pedestrian
    assert "unknown ones are vehicles, too: say what they are" in draft(path)
    of_ngsim = table.rename(columns={"agent_type": "v_Class"})
    assert drafted(path, of_ngsim).kinds == {"1": "motorcycle", "2": "car", "3": "truck"}


def test_kinds_of_argoverse(tmp_path: Path, traffic: Traffic) -> None:
    said = ["vehicle", "motorcyclist", "riderless_bicycle", "background", "bus"]
    table = traffic().assign(
        object_type=lambda rows: rows["track_id"].map(dict(enumerate(said, 1))),
        timestep=lambda rows: (rows["timestamp"] * 25).round().astype(int),
    )
    mapping = drafted(tmp_path / "case.parquet", table.drop(columns=["timestamp", "agent_type"]))
    assert mapping.columns.frame == "timestep"
    assert mapping.kinds == dict(zip(said, ["car", "motorcycle", "drop", "drop", "truck"], strict=True))


@pytest.mark.parametrize(
    ("names", "clip"),
    [
        ((np.nan, 7.0, 8.0), 7),
        (("", "007", "8b"), "007"),
        (tuple(np.arange("2024-01", "2024-04", dtype="M8[M]")), "2024-01-01 00:00:00"),
    ],
)
def test_clips_by_any_name(tmp_path: Path, traffic: Traffic, names: tuple[Any, ...], clip: int | str) -> None:
    path = tmp_path / "case.parquet"
    mapping = drafted(path, pd.concat([traffic().assign(case_id=name) for name in names]))
    assert mapping.clip == clip
    assert convert(path, mapping)[1].left_out == {f"of another clip than {clip}": 2 * len(traffic())}


@pytest.mark.parametrize(
    ("names", "kind", "ours"),
    [
        (["vehicle_id", "timestep_time", "vehicle_x", "vehicle_y", "vehicle_angle", "vehicle_type"], "bus", "truck"),
        (["actor_id", "timestamp", "x", "y", "yaw", "type_id"], "walker.pedestrian.0012", "drop"),
        (
            ["instance_token", "timestamp", "translation_x", "translation_y", "yaw", "category_name"],
            "vehicle.car",
            "car",
        ),
        (["carId", "time", "carCenterX", "carCenterY", "heading", "class"], "vehicle.bus.rigid", "truck"),
        (["OBJID", "TIMESTAMP", "UTM_X", "UTM_Y", "UTM_ANGLE", "CLASS"], "Bicycle", "drop"),
    ],
)
def test_names_of_simulators_and_data_sets(
    path: Path, traffic: Traffic, names: list[str], kind: str, ours: str
) -> None:
    given = ["track_id", "timestamp", "x", "y", "heading", "agent_type"]
    lanes = traffic().assign(agent_type=kind, vehicle_lane="E1_0")
    mapping = drafted(path, lanes.rename(columns=dict(zip(given, names, strict=True))))
    read = [getattr(mapping.columns, name) for name in ("vehicle_id", "time", "x", "y", "yaw", "kind", "lane")]
    assert read == [*names, None] and mapping.kinds == {kind: ours}
    assert mapping.reference == ("front_centre" if names[2] == "vehicle_x" else "box_centre")


def test_frames_have_a_rate_that_only_the_source_knows(path: Path, traffic: Traffic) -> None:
    table = traffic().assign(frame=lambda rows: (rows["timestamp"] * 25).round().astype(int)).drop(columns="timestamp")
    assert "rate_hz: 25.0  # a guess by the change of positions" in draft(written(path, table))
    bare = table.drop(columns=["speed", "heading"])
    assert "rate_hz: 10.0  # a guess: frames per second of the camera" in draft(written(path, bare))


@pytest.mark.parametrize(
    ("rate", "unit", "factor"),
    [(2.0, "m/s", 1.0), (5.0, "km/h", 3.6), (12.5, "mph", 1.0 / 0.44704), (25.0, "ft/s", 1.0 / 0.3048)],
)
def test_the_rate_of_frames_by_which_speeds_agree(
    path: Path, traffic: Traffic, rate: float, unit: str, factor: float
) -> None:
    slow = 0.25  # 3 m/s and less, which would be 1 m/s at the 10 Hz that a draft begins with
    table = traffic(x=slow, y=slow, speed=slow * factor)
    frame = table["timestamp"] * rate
    table = table.assign(frame=frame.round().astype(int))[np.abs(frame - frame.round()) < 1e-6]
    mapping = drafted(path, table.drop(columns="timestamp"))
    assert (mapping.rate_hz, mapping.units.speed) == (rate, unit)


@pytest.mark.parametrize(
    ("x", "without", "position", "speed"),
    [
        ("x", [], "ft", "ft/s"),
        ("x", ["speed", "heading"], "ft", "m/s"),
        ("x_m", [], "m", "m/s"),
        ("Easting", [], "m", "m/s"),
        ("utm_x", ["speed"], "m", "m/s"),
    ],
)
def test_positions_are_in_feet_where_sizes_are_unless_their_name_says_metres(
    path: Path, traffic: Traffic, x: str, without: list[str], position: str, speed: str
) -> None:
    """Feet and ft/s agree with each other as well as metres and m/s do: only sizes, whose range is known, tell."""
    table = traffic(x=1 / 0.3048, y=1 / 0.3048, speed=1 / 0.3048, length=1 / 0.3048, width=1 / 0.3048)
    text = draft(written(path, table.drop(columns=without).rename(columns={"x": x})))
    mapping = mapping_of(text)
    assert (mapping.units.size, mapping.units.position, mapping.units.speed) == ("ft", position, speed)
    assert ("position: ft  # a guess: sizes are in feet, too" in text) == (position == "ft")


def test_a_table_without_places(path: Path, traffic: Traffic) -> None:
    written(path, traffic().drop(columns=["x", "timestamp"]))
    with pytest.raises(InputError, match=r"no column looks like x, time or frame; the file has \['track_id', 'y'"):
        draft(path)
    written(path, traffic().rename(columns={"x": "lon", "y": "Latitude"}))
    with pytest.raises(InputError, match=r"columns lon and Latitude are no longitudes and latitudes of one place"):
        draft(path)


@pytest.mark.parametrize(
    ("factors", "units", "said"),
    [
        ({"x": 100.0, "y": 100.0, "speed": 3.6}, ("cm", "km/h"), "speed agrees with no change of positions in m"),
        ({"speed": 40.0}, ("m", "km/h"), "with the change of positions in this unit, but is off by a factor of 11"),
    ],
)
def test_a_unit_of_positions_by_which_speeds_agree(
    path: Path, traffic: Traffic, factors: dict[str, float], units: tuple[str, str], said: str
) -> None:
    text = draft(written(path, traffic(**factors)))
    mapping = mapping_of(text)
    assert (mapping.units.position, mapping.units.speed) == units
    assert said in text


def test_corners_of_boxes_in_a_picture_and_components_of_speed(path: Path, traffic: Traffic) -> None:
    """Columns as in highD: the width of a box is the length of the vehicle, and frames tell nothing of their rate."""
    table = traffic()
    gone = table["speed"] * table["timestamp"]
    picture = pd.DataFrame(
        {
            "frame": (25.0 * table["timestamp"]).round().astype(int),
            "id": table["track_id"],
            "x": 400.0 - gone - 2.2,
            "y": 4.0 * table["track_id"] - 0.9,
            "width": table["length"],
            "height": table["width"],
            "xVelocity": -table["speed"],
            "yVelocity": 0.0,
        }
    )
    mapping = drafted(path, picture)
    columns = mapping.columns
    assert (columns.length, columns.width, columns.speed) == ("width", "height", ("xVelocity", "yVelocity"))
    assert mapping.reference == "box_corner"
    assert mapping.rate_hz == 25.0
    made = convert(path, mapping)[0].table
    first = made[made["frame"] == 0]
    np.testing.assert_allclose(first["x"], 400.0, atol=1e-9)
    np.testing.assert_allclose(first["y"], 4.0 * first["vehicle_id"], atol=1e-9)
    np.testing.assert_allclose(made["speed"], 6.0 + made["vehicle_id"])


@pytest.mark.parametrize("column", ["timestamp", "x", "heading", "speed", "width"])
def test_cells_that_are_no_numbers(path: Path, traffic: Traffic, column: str) -> None:
    """A draft does without an optional column with an empty cell; text, such as decimal commas, is refused."""
    table = traffic()
    with_gap = drafted(path, table.assign(**{column: table[column].where(table.index != 2)}))
    whole = drafted(path, table)
    assert with_gap.columns == whole.columns.model_copy(update={OPTIONAL[column]: None} if column in OPTIONAL else {})
    written(path, table.astype({column: object}).assign(**{column: "1,5"}))
    with pytest.raises(InputError, match=f"case.csv: line 2: column '{column}' is '1,5', expected a number; 1500 such"):
        draft(path)


def test_a_draft_for_dates(path: Path, traffic: Traffic) -> None:
    table = traffic()
    table["timestamp"] = pd.Timestamp("2024-05-17T08:30:00") + pd.to_timedelta(table["timestamp"], unit="s")
    made = made_of(path, table)
    assert made["frame"].max() == 119
    assert made["speed"].max() == pytest.approx(11.0)
