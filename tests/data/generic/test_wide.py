"""Tables with a row for each vehicle, as published; and the mappings of data sets that the package has."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from command_line import refusal
from litsim_data.cli import main
from litsim_data.generic.draft import draft
from litsim_data.generic.geography import projected
from litsim_sim.scenario.recording import Recording
from made_published import FOOT, SPEEDS, TIMES, Made, citysim, i24_motion, pneuma, sind, songdo

MADE: dict[str, tuple[Made, float, tuple[float, float]]] = {
    "pneuma": (pneuma, 0.5 * np.pi, (4.6, 1.9)),
    "i24_motion": (i24_motion, np.pi, (15.0 * FOOT, 6.0 * FOOT)),
    "citysim": (citysim, 0.0, (4.6, 1.9)),
    "songdo": (songdo, 0.5 * np.pi, (4.6, 1.9)),
    "sind": (sind, 0.5 * np.pi, (4.6, 1.9)),
}
"""What writes each, and the heading [rad] and size [m] of the first vehicle."""


@pytest.mark.parametrize("name", MADE)
def test_published_tables_need_no_mapping(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write, yaw, size = MADE[name]
    main(["import", str(write(tmp_path)), str(tmp_path / "made.parquet")])
    recording = Recording.read(tmp_path / "made.parquet")
    vehicles = recording.table.groupby("vehicle_id")
    np.testing.assert_allclose(sorted(vehicles["speed"].mean()), SPEEDS, rtol=0.002)
    assert np.abs(np.cos(recording.table["yaw"] - yaw) - 1.0).max() < 0.001
    first = recording.table.iloc[0]
    assert (first["length"], first["width"]) == pytest.approx(size)
    assert recording.header.name.startswith(name) and recording.header.source and recording.header.licence
    assert f"rows       {3 * (240 if name == 'citysim' else len(TIMES))} read" in capsys.readouterr().out


def test_where_the_rear_is(tmp_path: Path) -> None:
    main(["import", str(i24_motion(tmp_path)), str(tmp_path / "made.parquet")])
    truck = Recording.read(tmp_path / "made.parquet").table.query("kind == 1").iloc[0]
    assert truck["x"] == pytest.approx(320_000.0 * FOOT - 6.0) and truck["y"] == pytest.approx(42.0 * FOOT)
    assert truck["frame"] == 0


def test_the_draft_of_a_published_table_is_its_mapping(tmp_path: Path) -> None:
    text = draft(citysim(tmp_path))
    assert yaml.safe_load(text)["columns"]["x"] == "carCenterXft" and text.startswith("# CitySim")


def test_repeated_columns_and_degrees_are_drafted(tmp_path: Path) -> None:
    path = pneuma(tmp_path)
    path.write_text(path.read_text().replace("track_id", "vehicle").replace("lon_acc; lat_acc", "a; b"))
    path.write_text(path.read_text().replace("vehicle;", "vehicle_id;", 1))
    text = draft(path)
    fields = yaml.safe_load(text)
    assert fields["repeated"] == ["lat", "lon", "speed", "a", "b", "time"]
    assert fields["columns"]["x"] == "lon" and fields["origin"] == pytest.approx([37.98, 23.735], abs=0.002)
    assert fields["units"]["speed"] == "km/h" and fields["units"]["position"] == "m"
    (tmp_path / "m.yaml").write_text(text)
    main(["import", str(path), str(tmp_path / "made.parquet"), "--mapping", str(tmp_path / "m.yaml")])
    table = Recording.read(tmp_path / "made.parquet").table
    np.testing.assert_allclose(sorted(table.groupby("vehicle_id")["speed"].mean()), SPEEDS, rtol=0.002)


@pytest.mark.parametrize(
    ("write", "old", "new", "message"),
    [
        (pneuma, "; 0; 0; 0.040000;", "; 0; 0.040000;", "line 2: 1203 cells, expected 4 and then whole sets of 6"),
        (pneuma, "; 0; 0; 0.040000;", "; 0; far; 0.040000;", "line 2: could not convert string to float: 'far'"),
        (pneuma, "37.98000000", "47.98", "row 1 of its tracks: latitude 47.98 and longitude 23.735"),
        (i24_motion, '"width": 6.0', '"width": [6.0, 6.0]', "object 1: arrays differ in length: "),
        (i24_motion, '"width": 6.0', '"width": [[6.0]]', "object 1: arrays differ in length: "),
        (i24_motion, '"width": 6.0', '"width": {"a": 1, "b": 2}', "object 1: width holds {'a': 1, 'b': 2}"),
        (i24_motion, '"width": 6.0', '"width": {}', "object 1: width holds {}"),
        (i24_motion, '"y_position"', '"y"', "object 1: column 'y_position' is empty or nan"),
        (i24_motion, '"length": 15.0', '"length": 1e999', "object 1: column 'length' is 'inf', expected a number"),
        (songdo, "08:59:55.040", "08:59:65.040", "line 3: column 'Local_Time' is '08:59:65.040', expected a number"),
    ],
)
def test_published_tables_with_defects(
    write: Made, old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    assert f"error: {path}: {message}" in refusal(capsys, main, "import", path, tmp_path / "made.parquet")


@pytest.mark.parametrize("origin", [(49.0, 8.4), (-33.9, 151.2), (64.1, -21.9), (60.4, 5.3), (78.2, 15.6)])
def test_degrees_become_metres_as_on_maps(origin: tuple[float, float]) -> None:
    pytest.importorskip("lanelet2")
    from lanelet2.core import GPSPoint
    from lanelet2.io import Origin
    from lanelet2.projection import UtmProjector

    places = np.array([(0.01, 0.02), (-0.1, 0.3), (0.5, -0.6)]) + origin
    right = [UtmProjector(Origin(*origin)).forward(GPSPoint(*place, 0.0)) for place in places]
    np.testing.assert_allclose(projected(*places.T, origin), np.array([(one.x, one.y) for one in right]).T, atol=1e-6)
