"""Published formats become recordings; generated ones are repeatable and sound; `data` says what is wrong."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from litsim_data import cli as data
from litsim_data.ngsim.sites import US101
from litsim_data.traffic import synthetic
from litsim_data.traffic.sites import US101_LIKE
from litsim_data.traffic.synthetic import synthesize
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import packaged

EMBEDDED = packaged("scenarios/us101_like.parquet")
WINDOW = {"frame": [316, 543], "local_y_m": [180, 415]}


@pytest.fixture(scope="module")
def real_file(real_data) -> Path:
    return real_data()


@pytest.fixture(scope="module", params=[EMBEDDED, packaged("scenarios/demo.parquet")], ids=lambda file: file.stem)
def embedded_file(request: pytest.FixtureRequest) -> Path:
    """Each packaged recording of generated traffic."""
    return Path(request.param)


@pytest.fixture(scope="module")
def embedded(embedded_file: Path) -> Recording:
    return load_recording(embedded_file)


def windows(vehicles: int = 3, frames: int = 4) -> pd.DataFrame:
    """A small file in the windows format: vehicles in a row, driving along the anchor's +x of the map."""
    rows = [(vehicle, frame) for vehicle in range(1, vehicles + 1) for frame in range(316, 316 + frames)]
    vehicle, frame = (np.array(column) for column in zip(*rows, strict=True))
    along = 10.0 * vehicle + 1.2 * (frame - 316)
    turn = -US101.yaw
    return pd.DataFrame(
        {
            "vehicle_id": vehicle,
            "frame": frame,
            "t_ms": 1118846987000 + 100 * frame,
            "local_x_m": 9.6,
            "local_y_m": 297.0 + along,
            "global_x_m": US101.global_anchor[0] + along * np.cos(turn),
            "global_y_m": US101.global_anchor[1] + along * np.sin(turn),
            "heading_rad": turn,
            "speed_mps": 12.0,
            "accel_mps2": 0.5,
            "length_m": np.array([4.0, 2.5, 12.0])[(vehicle - 1) % 3],
            "width_m": np.array([1.8, 1.2, 2.5])[(vehicle - 1) % 3],
            "lane_est": 3,
            "src": 0,
            "scenario": "made",
        }
    )


def written(tmp_path: Path, table: pd.DataFrame) -> Path:
    path = tmp_path / "windows.parquet"
    table.to_parquet(path)
    return path


# The windows format


def test_front_centres_become_box_centres_in_the_map_frame(tmp_path: Path) -> None:
    recording = load_recording(written(tmp_path, windows()))
    first = recording.table[recording.table["frame"] == 317].set_index("vehicle_id")
    along = np.array([11.2, 21.2, 31.2])
    np.testing.assert_allclose(first["x"], US101.map_anchor[0] + along - 0.5 * first["length"], atol=1e-6)
    np.testing.assert_allclose(first["y"], US101.map_anchor[1], atol=1e-6)
    np.testing.assert_allclose(first["yaw"], 0.0, atol=1e-9)
    assert first["kind"].tolist() == [Kind.CAR, Kind.MOTORCYCLE, Kind.TRUCK]
    assert recording.header.net == "us101.net.xml"


def test_tracks_without_heading_are_left_out(tmp_path: Path) -> None:
    table = windows()
    table.loc[table["vehicle_id"] == 2, ["src", "heading_rad"]] = [2, np.nan]
    assert load_recording(written(tmp_path, table)).table["vehicle_id"].unique().tolist() == [1, 3]
    with pytest.raises(InputError, match="no rows of the windows"):
        load_recording(written(tmp_path, table.assign(src=2)))


def test_windows_files_with_defects(tmp_path: Path) -> None:
    table = windows()
    with pytest.raises(InputError, match=r"unknown columns \['colour'\]"):
        load_recording(written(tmp_path, table.assign(colour=1)))
    with pytest.raises(InputError, match=r"missing columns \['heading_rad'\]"):
        load_recording(written(tmp_path, table.drop(columns="heading_rad")))
    with pytest.raises(InputError, match=r"columns \['speed_mps'\] do not hold numbers"):
        load_recording(written(tmp_path, table.assign(speed_mps="fast")))
    for index in (True, False):  # with an index in the file, it is read by pandas
        table.drop(index=1).to_parquet(tmp_path / "windows.parquet", index=index)
        with pytest.raises(InputError, match="crop it to one"):
            load_recording(tmp_path / "windows.parquet")
    with pytest.raises(InputError, match="column speed is nan"):
        load_recording(written(tmp_path, table.assign(speed_mps=np.nan)))


# Any format


def test_crop_keeps_its_limits_and_names_columns_of_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, windows())
    cropped = load_recording(path, {"frame": [317, 318], "local_y_m": [310, 400]}).table
    assert sorted(set(cropped["frame"])) == [317, 318]
    assert sorted(set(cropped["vehicle_id"])) == [2, 3]
    neutral, whole = load_recording(EMBEDDED, {"frame": [10, 20]}).table, load_recording(EMBEDDED).table
    pd.testing.assert_frame_equal(neutral, whole[whole["frame"].between(10, 20)].reset_index(drop=True))


@pytest.mark.parametrize(
    ("crop", "message"),
    [
        ({"local_z": [0, 1]}, "unknown column 'local_z'"),
        ({"frame": [5000, 6000]}, "leaves no rows"),
        ({"frame": [1]}, r"expected \[low, high\]"),
        ({"frame": ["a", "b"]}, r"expected \[low, high\]"),
        ({"scenario": [0, 1]}, "does not hold numbers"),
    ],
)
def test_crops_that_do_not_fit(tmp_path: Path, crop: dict[str, list[float]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_recording(written(tmp_path, windows()), crop)


def test_files_of_no_known_format(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such recording"):
        load_recording(tmp_path / "absent.parquet")
    (tmp_path / "text.parquet").write_text("x")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        load_recording(tmp_path / "text.parquet")
    pd.DataFrame({"a": [1]}).to_parquet(tmp_path / "other.parquet")
    with pytest.raises(InputError, match="format not recognised"):
        load_recording(tmp_path / "other.parquet")


# Generated traffic


def test_an_embedded_recording_is_what_the_code_generates() -> None:
    embedded = load_recording(EMBEDDED)
    seed = embedded.header.notes["seed"]
    again = synthesize(seed, 28.1, US101_LIKE)  # type: ignore[arg-type]
    assert again.header == embedded.header
    pd.testing.assert_frame_equal(again.table, embedded.table, check_exact=False, atol=2e-4, rtol=0.0)
    assert EMBEDDED.stat().st_size < 1_000_000


def test_no_time_to_generate() -> None:
    with pytest.raises(InputError, match="holds no frame"):
        synthesize(1, 0.0, US101_LIKE)


def test_generated_traffic_resembles_the_site(embedded: Recording) -> None:
    table = embedded.table
    window = table[table["x"].between(180, 413)]
    per_frame = window.groupby("frame").size()
    assert 40 <= per_frame.mean() <= 50  # the real window has 44.6
    assert 10.0 <= window["speed"].mean() <= 15.0
    assert window["speed"].std() > 2.0
    assert set(table["lane"]) == {1, 2, 3, 4, 5, 6}
    assert {Kind.CAR, Kind.TRUCK} <= set(table["kind"]) <= {Kind.CAR, Kind.TRUCK, Kind.MOTORCYCLE}
    assert table["x"].between(*US101_LIKE.window[::2]).all()


def test_a_crop_that_cuts_holes_into_tracks_is_named(embedded: Recording, tmp_path: Path) -> None:
    path = tmp_path / "swerving.parquet"
    Recording(embedded.header, {**embedded.columns, "y": embedded.columns["frame"] % 20.0}).write(path)
    with pytest.raises(InputError, match=r"swerving.parquet, cropped to y within \[0, 9\.5\]: vehicle_id 1: .* a hole"):
        load_recording(path, {"y": [0, 9.5]})


# Real traffic


@pytest.mark.data
def test_the_real_window(real_file: Path) -> None:
    recording = load_recording(real_file, WINDOW)
    table = recording.table
    assert table["vehicle_id"].nunique() == 108
    per_frame = table.groupby("frame").size()
    assert (per_frame.min(), per_frame.max(), len(per_frame)) == (41, 48, 228)
    boxes = (table[name].to_numpy() for name in ("x", "y", "yaw", "length", "width", "frame"))
    assert not len(overlapping_pairs(*boxes))
    track = table.sort_values(["vehicle_id", "frame"])
    same = np.diff(track["vehicle_id"]) == 0
    speed = np.hypot(np.diff(track["x"]), np.diff(track["y"]))[same] / STEP_S
    ratio = speed.sum() / track["speed"].to_numpy()[1:][same].sum()
    assert ratio == pytest.approx(1.0, abs=0.003)  # distances are true


@pytest.mark.data
def test_the_fitted_net_lies_under_the_real_window(real_file: Path) -> None:
    table = load_recording(real_file, WINDOW).table
    lane_map = LaneMap.from_net(packaged("nets/us101.net.xml"))
    at = lane_map.nearest(*(table[name].to_numpy() for name in ("x", "y", "yaw")))
    half = np.array([lane.width / 2 for lane in lane_map.lanes])
    assert (np.abs(at.d) <= half[at.lane]).mean() >= 0.97
    lanes = {"weave": 6, "upstream": 5, "downstream": 5, "on_ramp": 6, "off_ramp": 6}
    from_left = np.array([lanes[lane.edge_id] - lane.index for lane in lane_map.lanes])[at.lane]
    assert (from_left == table["lane"]).mean() >= 0.97


@pytest.mark.data
def test_the_whole_real_file_asks_for_a_crop(real_file: Path) -> None:
    with pytest.raises(InputError, match="crop it to one, such as frame 316 to 543"):
        load_recording(real_file)


# `data`


def test_info_and_convert(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.parquet"
    data.main(["convert", str(written(tmp_path, windows())), str(out), "--crop", "frame", "316", "318"])
    assert "3 (1 car, 1 truck, 1 motorcycle)" in capsys.readouterr().out
    assert len(Recording.read(out).table) == 9
    data.main(["info", str(out)])
    text = capsys.readouterr().out
    assert "316 to 318 (0.2 s at 10 Hz), 9 rows" in text
    assert "CC BY-SA" in text


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    data.main(["list"])
    text = capsys.readouterr().out
    assert all(name in text for name in ("demo", "us101_0750", "us101_like.net.xml", "small"))


def test_synthesize(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr(synthetic, "synthesize", lambda *given: asked.append(given) or load_recording(EMBEDDED))
    out = tmp_path / "made.parquet"
    data.main(["synthesize", "--seed", "5", "--seconds", "1", "--out", str(out)])
    assert asked == [(5, 1.0, US101_LIKE)] and Recording.read(out).header.name == "us101_like"
    assert "simulating" in capsys.readouterr().err
