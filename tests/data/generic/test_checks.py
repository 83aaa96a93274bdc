"""Wrong units and conventions are found by what gives them away, and nothing is written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import made_tables
from litsim_sim.core.errors import InputError

COLUMNS = {
    "vehicle_id": "track_id",
    "time": "timestamp",
    "x": "x",
    "y": "y",
    "yaw": "heading",
    "speed": "speed",
    "length": "length",
    "width": "width",
}
FIELDS: dict[str, Any] = {"name": "made", "columns": COLUMNS, "reference": "box_centre"}
FOOT = 1.0 / 0.3048

Traffic = Callable[..., pd.DataFrame]


def converted(folder: Path, table: pd.DataFrame, **fields: Any) -> pd.DataFrame:
    return made_tables.converted(folder / "in.parquet", table, FIELDS | fields)[0].table


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory, traffic: Traffic) -> pd.DataFrame:
    """What conversion makes of the traffic."""
    return converted(tmp_path_factory.mktemp("right"), traffic())


def test_a_right_mapping_is_taken(right: pd.DataFrame) -> None:
    assert right["vehicle_id"].nunique() == 5
    assert right["speed"].max() == pytest.approx(11.0)


@pytest.mark.parametrize(
    ("factors", "said", "mended"),
    [
        ({"heading": 180 / np.pi}, r"goes up to 74\.87 rad; units.angle deg would fit", {"angle": "deg"}),
        ({"timestamp": 1000.0}, r"follow each other by 40 s .*; units.time ms would fit", {"time": "ms"}),
        ({"x": FOOT, "y": FOOT}, r"change 3\.28 times as fast .*; units.position ft", {"position": "ft"}),
        ({"speed": 3.6}, r"change 0\.278 times as fast .*units.speed km/h", {"speed": "km/h"}),
        ({"length": FOOT, "width": FOOT}, r"wider than 5\.91 m, .*; units.size ft would fit", {"size": "ft"}),
    ],
)
def test_units(
    tmp_path: Path, traffic: Traffic, right: pd.DataFrame, factors: dict[str, float], said: str, mended: dict[str, str]
) -> None:
    table = traffic(**factors)
    with pytest.raises(InputError, match=said):
        converted(tmp_path, table)
    pd.testing.assert_frame_equal(converted(tmp_path, table, units=mended), right, atol=1e-6, rtol=0.0)


@pytest.mark.parametrize(
    ("change", "mended", "said"),
    [
        (lambda yaw: -yaw, {"positive": "clockwise"}, "angles.positive clockwise would fit"),
        (lambda yaw: yaw - np.pi / 2, {"zero": "y"}, "angles.zero y would fit"),
        (
            lambda yaw: np.pi / 2 - yaw,
            {"zero": "y", "positive": "clockwise"},
            "angles.zero y with angles.positive clockwise would fit",
        ),
    ],
)
def test_conventions_of_headings(
    tmp_path: Path, traffic: Traffic, right: pd.DataFrame, change: Any, mended: dict[str, str], said: str
) -> None:
    table = traffic().assign(heading=lambda rows: change(rows["heading"]))
    with pytest.raises(InputError, match=said):
        converted(tmp_path, table)
    pd.testing.assert_frame_equal(converted(tmp_path, table, angles=mended), right, atol=1e-6, rtol=0.0)


def test_a_mirrored_source_needs_its_mirror_for_positions_only(
    tmp_path: Path, traffic: Traffic, right: pd.DataFrame
) -> None:
    """Headings turn with the axes: those of an image, whose y grows downwards, agree with motion in it."""
    table = traffic().assign(y=lambda rows: -rows["y"], heading=lambda rows: -rows["heading"])
    mirrored = converted(tmp_path, table, transform={"mirror_y": True})
    pd.testing.assert_frame_equal(mirrored, right, atol=1e-6, rtol=0.0)
    turned = converted(tmp_path, table, transform={"mirror_y": True, "yaw_deg": 40.0})
    assert turned["yaw"].iloc[0] == pytest.approx(np.deg2rad(40.0), abs=1e-6)
    with pytest.raises(InputError, match=r"angles\.positive clockwise would fit"):
        converted(tmp_path, table.assign(heading=-table["heading"]), transform={"mirror_y": True, "yaw_deg": 40.0})


def test_a_frame_rate_that_is_wrong(tmp_path: Path, traffic: Traffic) -> None:
    table = traffic().assign(frame=lambda rows: (rows["timestamp"] * 25).round().astype(int))
    columns = {name: column for name, column in COLUMNS.items() if name != "time"} | {"frame": "frame"}
    assert len(converted(tmp_path, table, columns=columns, rate_hz=25))
    for rate, said in ((10, r"0\.4"), (20, r"0\.8"), (30, r"1\.2")):
        with pytest.raises(InputError, match=rf"change {said} times as fast .* rate_hz 25 would fit"):
            converted(tmp_path, table, columns=columns, rate_hz=rate)


def test_without_speeds_only_the_impossible_is_refused(tmp_path: Path, traffic: Traffic) -> None:
    columns = {name: column for name, column in COLUMNS.items() if name != "speed"}
    assert len(converted(tmp_path, traffic(), columns=columns))
    with pytest.raises(InputError, match=r"change by 1\d\d\d m/s in one row of ten .* units\.position, which is m,"):
        converted(tmp_path, traffic(x=100.0, y=100.0), columns=columns)


def test_degrees_are_no_metres(tmp_path: Path, traffic: Traffic) -> None:
    table = traffic().assign(x=lambda rows: 8.4 + rows["x"] / 73e3, y=lambda rows: 49.0 + rows["y"] / 111e3)
    with pytest.raises(InputError, match=r"column 'speed' says \(median\); or are they degrees\?"):
        converted(tmp_path, table)
    without = {name: column for name, column in COLUMNS.items() if name != "speed"}
    with pytest.raises(InputError, match=r"no vehicle moves: is units\.position, .* or are they degrees\?"):
        converted(tmp_path, table, columns=without)


def test_a_speed_along_an_axis(tmp_path: Path, traffic: Traffic) -> None:
    table = traffic().assign(speed=lambda rows: np.where(rows["track_id"] > 3, -1.0, 1.0) * rows["speed"])
    with pytest.raises(InputError, match=r"column 'speed' is below -5 m/s in 40% of the rows, .* along an axis\?"):
        converted(tmp_path, table)


def wavy(traffic: Traffic) -> pd.DataFrame:
    """The same cars, straight on one behind the other, their speed swinging by 2 m/s; with column `acceleration`."""
    table = traffic()
    t, number = table["timestamp"], table["track_id"]
    return table.assign(
        x=10.0 * t - 2.0 * np.cos(t) + 30.0 * number,
        y=5.0,
        heading=0.0,
        speed=10.0 + 2.0 * np.sin(t),
        acceleration=2.0 * np.cos(t),
    )


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (FOOT, "says 3.28 times .*units.acceleration ft/s2 would fit"),
        (1.0 / 9.80665, "says 0.102 times .*units.acceleration g would fit"),
        (-1.0, "the opposite of how speeds change in 100% of .* or is braking positive"),
        (0.0, "says 0 times .*without field columns.acceleration"),
    ],
)
def test_accelerations_are_changes_of_speed(tmp_path: Path, traffic: Traffic, factor: float, said: str) -> None:
    columns = COLUMNS | {"acceleration": "acceleration"}
    right = converted(tmp_path, wavy(traffic), columns=columns)
    np.testing.assert_allclose(right["acceleration"], 2.0 * np.cos(0.1 * right["frame"]), atol=0.01)
    wrong = wavy(traffic).assign(acceleration=lambda rows: factor * rows["acceleration"])
    with pytest.raises(InputError, match=f"{said}.*\\(check acceleration\\)"):
        converted(tmp_path, wrong, columns=columns)
    assert len(converted(tmp_path, wrong, columns=columns, accept=["acceleration"]))
    units = {FOOT: "ft/s2", 1.0 / 9.80665: "g"}
    if factor in units:
        mended = converted(tmp_path, wrong, columns=columns, units={"acceleration": units[factor]})
        pd.testing.assert_frame_equal(mended, right, atol=1e-9, rtol=0.0)


def test_an_angle_that_only_few_vehicles_tell(tmp_path: Path, traffic: Traffic) -> None:
    """Along x headings are the same by both senses of rotation; who comes from a side street is not."""
    straight = wavy(traffic)
    crossing = straight[straight["track_id"] == 1].assign(track_id=9, x=60.0, y=straight["x"], heading=np.pi / 2)
    table = pd.concat([straight, crossing], ignore_index=True)
    assert converted(tmp_path, table)["yaw"].max() == pytest.approx(np.pi / 2)
    with pytest.raises(InputError, match=r"in 16\.7% of the moving rows, .*angles\.positive clockwise would fit"):
        converted(tmp_path, table.assign(heading=-table["heading"]))


def test_headings_by_another_north(tmp_path: Path, traffic: Traffic) -> None:
    table = wavy(traffic)
    assert len(converted(tmp_path, table.assign(heading=np.deg2rad(2.5))))
    with pytest.raises(InputError, match=r"are 3\.5 degrees to the left of their way"):
        converted(tmp_path, table.assign(heading=np.deg2rad(3.5)))
    with pytest.raises(InputError, match=r"5 vehicles that go straight are 12\.0 degrees to the right"):
        converted(tmp_path, table.assign(heading=-np.deg2rad(12.0)))


def test_swapped_sizes(tmp_path: Path, traffic: Traffic) -> None:
    with pytest.raises(InputError, match="are columns length and width swapped"):
        converted(tmp_path, traffic().rename(columns={"length": "width", "width": "length"}))


def test_half_sizes_and_small_vehicles(tmp_path: Path, traffic: Traffic) -> None:
    with pytest.raises(InputError, match=r"longer than 2\.2 m and wider than 0\.9 m, .* half of the sizes"):
        converted(tmp_path, traffic(length=0.5, width=0.5))
    small = traffic().assign(length=1.9, width=0.5)
    with pytest.raises(InputError, match="are most of them motorcycles or people"):
        converted(tmp_path, small)
    motorcycles = {"columns": FIELDS["columns"] | {"kind": "agent_type"}, "kinds": {"car": "motorcycle"}}
    assert converted(tmp_path, small, **motorcycles)["width"].max() == pytest.approx(0.5)


def test_two_rows_a_second(tmp_path: Path, traffic: Traffic) -> None:
    table = traffic()
    seldom = table[(table["timestamp"] * 25).round() % 13 == 0]
    assert converted(tmp_path, seldom)["vehicle_id"].nunique() == 5, "key frames of 2 Hz are 0.5 s apart, or a bit more"


def test_every_problem_is_told_and_those_accepted_are_not(tmp_path: Path, traffic: Traffic) -> None:
    table = traffic(speed=3.6, length=FOOT, width=FOOT)
    with pytest.raises(InputError) as caught:
        converted(tmp_path, table)
    assert "(check speed)" in str(caught.value)
    assert "(check size)" in str(caught.value)
    with pytest.raises(InputError) as caught:
        converted(tmp_path, table, accept=["speed"])
    assert "(check speed)" not in str(caught.value)
    assert "(check size)" in str(caught.value)


def test_traffic_that_stands_has_no_direction(tmp_path: Path, traffic: Traffic) -> None:
    parked = traffic().assign(x=5.0, y=lambda rows: 8.0 * rows["track_id"], heading=1.2, speed=0.0)
    assert converted(tmp_path, parked)["yaw"].to_numpy() == pytest.approx(1.2)


def test_noise_of_rows_a_few_hundredths_of_a_second_apart_is_not_taken_for_motion(
    tmp_path: Path, traffic: Traffic
) -> None:
    """5 cm at 25 Hz are 1.8 m/s from row to row; slow vehicles seem to go to all sides, and faster."""
    noise = np.random.default_rng(1).normal(0.0, 0.05, (2, 1500))
    x, y = (20.0 + 0.4 * (traffic()[axis] - 20.0) + each for axis, each in zip("xy", noise, strict=True))
    table = traffic(speed=0.4).assign(x=x, y=y)
    converted(tmp_path, table)
    with pytest.raises(InputError, match=r"headings are 90 degrees off .*angles.zero y would fit"):
        converted(tmp_path, table.assign(heading=table["heading"] - 0.5 * np.pi))
    with pytest.raises(InputError, match=r"change 0\.\d+ times as fast as column 'speed' says .*units.speed km/h"):
        converted(tmp_path, table.assign(speed=3.6 * table["speed"]))


def test_times_that_are_accepted_as_they_are_do_not_switch_off_other_checks(tmp_path: Path, traffic: Traffic) -> None:
    fields = {name: column for name, column in COLUMNS.items() if name != "speed"}
    with pytest.raises(InputError, match=r"positions change by 10\d{6} m/s in one row of ten"):
        converted(tmp_path, traffic(timestamp=1e-6), accept=["time"], columns=fields)
