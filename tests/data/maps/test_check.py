"""The check of a net as a command: what it prints of a net and of tracks with known faults, and its picture."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from command_line import refusal
from litsim_data.cli import main
from litsim_data.maps.check import NetCheck
from litsim_data.maps.connectivity import Connectivity
from litsim_data.maps.placement import Placement
from litsim_data.pictures.map_picture import FITTED, MISS, TRACK
from litsim_sim.core.scene import Kind
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged

EMBEDDED = packaged("scenarios/us101_like.parquet")


@pytest.fixture
def aside(tmp_path: Path) -> Path:
    """Traffic of the packaged motorway, 2 m to the left, by a mapping that has shifted it already by 1 m."""
    table = load_recording(EMBEDDED).table
    table = table[table["frame"] <= 100].assign(y=lambda rows: rows["y"] + 2.0)
    notes: dict[str, object] = {"mapping": {"transform": {"y": 1.0}}}
    Recording.of_table(RecordingHeader("aside", net="us101_like.net.xml", notes=notes), table).write(
        tmp_path / "aside.parquet"
    )
    return tmp_path / "aside.parquet"


def test_a_recording_without_vehicles_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = load_recording(EMBEDDED).table
    walking = table[table["vehicle_id"] == 1].assign(kind=int(Kind.PEDESTRIAN), length=0.6, width=0.6)
    Recording.of_table(RecordingHeader("walking", net="us101_like.net.xml"), walking).write(tmp_path / "w.parquet")
    for more in ([], ["--picture", str(tmp_path / "check.png")]):
        with pytest.raises(SystemExit):
            main(["map", "--check", "us101_like", "--recording", str(tmp_path / "w.parquet"), *more])
        captured = capsys.readouterr()
        assert not captured.out
        assert "w.parquet: holds only pedestrians and cyclists" in captured.err


def colours(path: Path) -> dict[str, int]:
    """Pixels of each colour in a picture."""
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    wanted = {name: [int(name[i : i + 2], 16) for i in (1, 3, 5)] for name in (TRACK, MISS, FITTED)}
    return {name: int((np.abs(pixels - rgb).max(axis=-1) <= 60).sum()) for name, rgb in wanted.items()}


def test_tracks_beside_their_net(aside: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "check.png"
    with pytest.raises(SystemExit, match="1"):
        main(["map", "--check", "us101_like", "--recording", str(aside), "--picture", str(picture)])
    said = capsys.readouterr().out
    table = load_recording(aside).table
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    off = table[~lane_map.inside_road(table["x"].to_numpy(), table["y"].to_numpy())]
    worst = off.loc[off["y"].idxmax()]
    first = next(line for line in said.splitlines() if line.split()[:1] == ["1"]).split()
    assert worst["y"] > 0.0, "where the leftmost lane ends"
    assert [int(first[1]), int(first[3])] == [worst["vehicle_id"], worst["frame"]]
    assert [float(value) for value in first[4:7]] == pytest.approx([worst["x"], worst["y"], worst["y"]], abs=0.01)
    assert f"recording: {off['vehicle_id'].nunique()} vehicles have been on no lane, 0% of these" in said
    assert re.search(r"shifted by \([+-]0\.0\d, -(2\.0|1\.9)\d\) m; the lanes do not tell how far along them", said)
    transform = next(line for line in said.splitlines() if "as a mapping's transform" in line)
    assert float(transform.rpartition("y: ")[2].rstrip("}")) == pytest.approx(-1.0, abs=0.15)
    assert "MISSED: recording: " in said and "SUMO: loads without warnings" in said
    shown = colours(picture)
    assert min(shown.values()) > 50, shown


def test_a_recording_elsewhere_is_brought_to_the_net(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = load_recording(EMBEDDED).table
    table = table[table["frame"] <= 100].assign(x=lambda rows: rows["x"] + 800.0, y=lambda rows: rows["y"] - 300.0)
    Recording.of_table(RecordingHeader("far", net="us101_like.net.xml"), table).write(tmp_path / "far.parquet")
    with pytest.raises(SystemExit, match="1"):
        main(["map", "--check", "us101_like", "--recording", str(tmp_path / "far.parquet")])
    said = capsys.readouterr().out
    assert "recording: no motion of about 10 m and 3 degrees puts more than 0.0% of it on lanes" in said
    assert "in place" not in said
    found = re.search(r"as a mapping's transform: {yaw_deg: 0, x: (.*), y: (.*)}", said)
    assert found is not None
    assert [float(value) for value in found.groups()] == pytest.approx([-800.0, 300.0], abs=60.0)


def test_coverage_by_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str], aside: Path) -> None:
    scenario = tmp_path / "aside.yaml"
    scenario.write_text("name: aside\nrecording: aside.parquet\nnet: us101_like\nego: 7\nsimulation_s: 4.0\n")
    with pytest.raises(SystemExit, match="1"):
        main(["map", "--check", "us101_like", "--scenario", "demo", "--scenario", str(scenario)])
    lines = capsys.readouterr().out.splitlines()
    shares = {line.split()[0]: line.split()[2] for line in lines[1:3]}
    assert shares["demo"] == "100.00%" and float(shares["aside"].rstrip("%")) < 90.0
    assert any(line.startswith("demo: in place") for line in lines)
    assert any(line.startswith("MISSED: aside: ") for line in lines) and not any(
        "MISSED: demo" in line for line in lines
    )


def test_a_picture_of_a_sound_net_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["map", "--check", "urban_like", "--picture", str(tmp_path / "new" / "net.png")])
    assert "without exit: none, without a way in: none; beginning late: AB_2, BA_2" in capsys.readouterr().out
    assert Image.open(tmp_path / "new" / "net.png").size[0] > 1000
    for bad, message in (("net.gif", "ends with .png"), ("/dev/null/net.png", "cannot be written")):
        assert message in refusal(capsys, main, "map", "--check", "urban_like", "--picture", tmp_path / bad)


def test_every_fault_is_a_failure() -> None:
    found = NetCheck(lanes=4, connectivity=Connectivity(stuck=("a_1",)), warnings=("odd",))
    assert found.failures == ["lane a_1 leads to no exit", "SUMO: odd"]
    nan = float("nan")
    wrong_way = Placement(100, 1.0, nan, nan, 0, 0.0, against=0.4)
    (said,) = NetCheck(lanes=4, placements={"recording": wrong_way}).failures
    assert said == "recording: 40.00% of the vehicle centres lie on lanes that lead the other way, goal at most 1%"
