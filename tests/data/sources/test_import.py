"""Data sets as they are published become recordings, nets and scenarios; each is written by the tests in its format."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

import made_sources
from command_line import refusal
from litsim_data.cli import main
from litsim_data.maps.lane_graph import LaneGraph
from litsim_data.maps.net_builder import write_graph
from litsim_data.sources.importing import files_of
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario
from made_maps import opendrive, road

Written = Callable[[Path], Path]


def imported(source: Path, out: Path, *more: str) -> tuple[Recording, LaneMap, list[Path]]:
    """The one scene of a source: its recording, its lanes, and its scenarios."""
    main(["import", str(source), str(out), *more])
    (path,) = out.glob("*.parquet")
    recording = Recording.read(path)
    assert path.with_suffix(".png").is_file()
    return recording, LaneMap.from_net(out / recording.header.net), sorted((out / "scenarios").glob("*_train_*.yaml"))


CROSSINGS: dict[str, tuple[Written, int, bool]] = {
    "argoverse": (lambda folder: made_sources.argoverse(folder / "av2"), 110, False),
    "commonroad": (lambda folder: made_sources.commonroad(folder / "made.xml"), 110, True),
    "osi": (lambda folder: made_sources.osi(folder / "made_gt.osi"), 110, False),
    "osi_mcap": (lambda folder: made_sources.osi(folder / "made_sv.mcap", "SensorView"), 110, False),
    "py123d": (lambda folder: made_sources.py123d(folder / "nuplan_made.parquet"), 110, True),
    "scenario_net": (lambda folder: made_sources.scenario_net(folder / "sd_made.pkl"), 110, True),
    "sumo": (lambda folder: made_sources.sumo(folder / "sumo"), 110, False),
    "waymo_json": (lambda folder: made_sources.waymo_json(folder / "made.json"), 90, True),
    "waymo_tfrecord": (lambda folder: made_sources.waymo_record(folder / "made.tfrecord-00000-of-00001"), 90, True),
}
"""What writes the crossing, the last frame, and whether the light is known; by format."""


@pytest.mark.parametrize("name", CROSSINGS)
def test_a_crossing_in_every_format(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if name.startswith("osi"):
        pytest.importorskip("osi3")
    write, last, lit = CROSSINGS[name]
    recording, lane_map, (scenario,) = imported(write(tmp_path), tmp_path / "out")
    text = capsys.readouterr().out
    table, right = recording.table, made_sources.tracks()
    kinds = table.drop_duplicates("vehicle_id").set_index("vehicle_id")["kind"]
    assert len(kinds) == 5 and (kinds == Kind.PEDESTRIAN).sum() == 1
    assert recording.header.licence and recording.header.source and table["frame"].max() == last
    for x, name_of_place in ((-120.0, 1), (-90.0, 2), (-60.0, made_sources.PARKED)):
        first = table[(table["frame"] == 0) & np.isclose(table["x"], x, atol=0.02)]
        assert len(first) == 1, x
        track = table[table["vehicle_id"] == first["vehicle_id"].iloc[0]]
        expected = right[(right["id"] == name_of_place) & (right["step"] <= track["frame"].max())]
        np.testing.assert_allclose(track[["x", "y"]], expected[["x", "y"]], atol=0.02)
        np.testing.assert_allclose(track["speed"], expected["speed"], atol=0.02)
        np.testing.assert_allclose(track[["length", "width"]].iloc[0], [4.6, 1.9], atol=0.02)
    outer = [lane for lane in lane_map.lanes if not lane.is_internal]
    assert len(outer) == 4 and len(lane_map.lanes) == 6
    across = lane_map.path_from(lane_map.nearest(np.array([-100.0]), np.array([0.0])).lane[0], 50.0, 200.0)
    assert np.abs(across[:, 1]).max() < 0.01 and across[-1, 0] > 90.0
    assert "parked     1 vehicles stand beside the lanes all the time" in text and "100.0%" in text
    loaded = Scenario.load(scenario)
    assert loaded.coverage == 1.0 and (loaded.signals is not None) == lit
    if loaded.signals is not None:
        assert [link.from_lane for link in loaded.signals.links] == [outer[0].id]
        assert "1 vehicles pass, 0 at red" in text or "2 vehicles pass, 0 at red" in text
    if name in (
        "argoverse",
        "osi",
        "osi_mcap",
        "py123d",
        "scenario_net",
        "waymo_json",
        "waymo_tfrecord",
    ):  # which know the vehicle that recorded the others
        x = -120.0 if name == "argoverse" else -90.0
        assert table.loc[(table["vehicle_id"] == loaded.ego_id) & (table["frame"] == 0), "x"].iloc[0] == pytest.approx(
            x
        )


@pytest.mark.parametrize("name", ["inD", "highD"])
def test_level_x(name: str, tmp_path: Path) -> None:
    folder = made_sources.level_x(tmp_path, name)
    recording, lane_map, _ = imported(folder, tmp_path / "out")
    table = recording.table
    assert set(table["vehicle_id"]) == {1, 2, 3} and table["frame"].max() == 110
    first = table[table["frame"] == 1].set_index("vehicle_id")
    np.testing.assert_allclose(first["y"], [-1.75, -1.75, 1.75], atol=1e-6)
    np.testing.assert_allclose(first["x"], [-119.4, -89.4, 109.34], atol=1e-6)
    np.testing.assert_allclose(np.cos(first["yaw"]), [1.0, 1.0, -1.0])
    assert not lane_map.against(*(table[axis].to_numpy() for axis in ("x", "y", "yaw"))).any()
    assert lane_map.inside_road(table["x"].to_numpy(), table["y"].to_numpy()).all()
    assert "must not be passed on" in recording.header.licence


@pytest.mark.parametrize("rule", ["", ' rule="LHT"'])
def test_interaction_on_a_map_that_may_say_the_wrong_side(
    rule: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its cars drive east at y = -1.75, on the right, whatever the map says of its side."""
    folder = made_sources.interaction(tmp_path)
    (tmp_path / "made.xodr").write_text(opendrive(road(rule=rule)))
    recording, lane_map, _ = imported(folder, tmp_path / "out", "--map", str(tmp_path / "made.xodr"))
    table = recording.table
    kinds = table.drop_duplicates("vehicle_id")["kind"].tolist()
    assert sorted(kinds) == [Kind.CAR, Kind.CAR, Kind.CAR, Kind.PEDESTRIAN]
    driving = table[table["kind"] == Kind.CAR]
    driving = driving[driving["speed"] > 1.0]
    assert not lane_map.against(*(driving[axis].to_numpy() for axis in ("x", "y", "yaw"))).any()
    told = "made.xodr: the tracks keep to the right, and so does the net, other than the file says"
    assert (told in capsys.readouterr().out) == bool(rule)


def test_several_scenes_and_one_that_cannot_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    made_sources.commonroad(tmp_path / "in" / "a.xml")
    (tmp_path / "in" / "b.xml").write_text("<commonRoad><lanelet/></commonRoad>")
    (tmp_path / "in" / "c.txt").write_text("notes")
    with pytest.raises(SystemExit, match="1"):
        main(["import", str(tmp_path / "in"), str(tmp_path / "out")])
    captured = capsys.readouterr()
    assert "b.xml: attribute timeStepSize" in captured.err and "ZAM_Made-1_1_T-1" in captured.out
    assert "exists already, expected a new folder" in refusal(capsys, main, "import", tmp_path / "in", tmp_path / "out")


def test_scenes_of_one_name_have_files_of_their_own(tmp_path: Path) -> None:
    for folder, step in (("a", 0.1), ("b", 0.2)):
        (tmp_path / "in" / folder).mkdir(parents=True)
        made_sources.commonroad(tmp_path / "in" / folder / "made.xml", step)
    main(["import", str(tmp_path / "in"), str(tmp_path / "out")])
    files = sorted(path.name for path in (tmp_path / "out").glob("*.*"))
    names = ["ZAM_Made-1_1_T-1", "ZAM_Made-1_1_T-1_2"]
    assert files == sorted(f"{name}.{ending}" for name in names for ending in ("net.xml", "parquet", "png"))
    assert {Scenario.load(path).net_path.name for path in (tmp_path / "out/scenarios").glob("*_train_*.yaml")} == {
        f"{name}.net.xml" for name in names
    }


def test_tracks_alone_are_converted_without_a_map(tmp_path: Path) -> None:
    folder = made_sources.sumo(tmp_path / "sumo", "csv")
    (folder / "made.net.xml").unlink()
    table = load_recording(folder / "fcd.csv").table
    assert set(table["vehicle_id"]) == {1, 2, 3, 4} and table["frame"].max() == 110
    np.testing.assert_allclose(table.loc[table["vehicle_id"] == 1, "x"].iloc[0], -120.0)
    with pytest.raises(SystemExit, match="2"):
        main(["import", str(folder), str(tmp_path / "out")])


def test_tracks_that_leave_the_map_are_cut_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = made_sources.argoverse(tmp_path / "av2")
    path = folder / "scenario_made.parquet"
    table = pd.read_parquet(path)
    early = table[table["track_id"] == "2"].assign(track_id="20", position_x=lambda rows: rows["position_x"] - 100.0)
    aside = early.assign(track_id="30", position_y=30.0)
    pd.concat([table, early, aside]).to_parquet(path)
    recording, *_ = imported(folder, tmp_path / "out")
    text = capsys.readouterr().out
    cut = recording.table[recording.table["vehicle_id"] == 20]
    assert cut["x"].min() == pytest.approx(-151.0) and cut["frame"].min() == 39, "half a width before the lane"
    assert "left out   39 rows of vehicles before they come onto the map or after they leave it" in text
    assert "left out   1 vehicles that drive beside the lanes only" in text


def test_motion_that_is_too_rough_is_cleaned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = made_sources.argoverse(tmp_path / "av2")
    path = folder / "scenario_made.parquet"
    table = pd.read_parquet(path)
    rough = (table["track_id"] == "2") & (table["timestep"].isin([40, 80]))
    table.loc[rough, "velocity_x"] += 30.0
    table.to_parquet(path)
    recording, *_ = imported(folder, tmp_path / "out")
    assert "noisy      cleaned: accelerations were impossible" in capsys.readouterr().out
    assert recording.table["acceleration"].abs().max() < 3.0


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "log_map_archive_made.json").unlink(), r"log_map_archive_made\.json: no such file"),
        (lambda folder: (folder / "log_map_archive_made.json").write_text("{"), "not readable as JSON"),
        (lambda folder: (folder / "log_map_archive_made.json").write_text("[]"), "no field lane_segments"),
        (
            lambda folder: edit(folder / "log_map_archive_made.json", lambda c: c["lane_segments"]["100"].pop("id")),
            r"field lane_segments\.100: field 'id' is missing",
        ),
    ],
)
def test_maps_of_argoverse_that_cannot_be_used(
    damage: Callable[[Path], object], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made_sources.argoverse(tmp_path / "av2")
    damage(folder)
    assert re.search(message, refusal(capsys, main, "import", folder, tmp_path / "out"))


def edit(path: Path, change: Callable[[dict], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_traces_of_osi_that_cannot_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("osi3")
    path = made_sources.osi(tmp_path / "in" / "made.osi", "SensorView")
    assert load_recording(path).table["frame"].max() == 110
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    assert "made.osi: message 111: the file ends within it, or is no OSI trace" in refusal(
        capsys, main, "import", path, tmp_path / "out"
    )
    path.write_bytes(len(whole).to_bytes(4, "little")[:4] + b"\xff" * len(whole))
    with pytest.raises(InputError, match="message 1: neither ground truth of OSI nor a sensor's view of it"):
        load_recording(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lanes": []}, r"nuplan_made\.parquet: holds no lanes, .*: name a net or OpenDRIVE by --map"),
        ({"lanes": [{"bicycles": False, "id": "7"}]}, r"lane 0 of its metadata: KeyError 'left'"),
        ({"lights": None}, r"metadata py123d: KeyError 'lights', expected what examples/py123d/export\.py writes"),
    ],
)
def test_logs_of_py123d_that_cannot_be_used(
    change: dict[str, Any], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made_sources.py123d(tmp_path / "nuplan_made.parquet")
    table = pq.read_table(path)
    content = {**json.loads(table.schema.metadata[b"py123d"]), **change}
    content = {field: value for field, value in content.items() if value is not None}
    pq.write_table(table.replace_schema_metadata({"py123d": json.dumps(content)}), path)
    assert re.search(message, refusal(capsys, main, "import", path, tmp_path / "out"))


def test_data_sets_of_py123d_have_their_own_licences_and_labels(tmp_path: Path) -> None:
    """PandaSet has no lanes: here those of a net that is named."""
    table = pq.read_table(made_sources.py123d(tmp_path / "nuplan.parquet"))
    content = json.loads(table.schema.metadata[b"py123d"]) | {"dataset": "pandaset", "lanes": [], "lights": []}
    labels = {"1": "pickup_truck", "3": "bus", "4": "motorcycle", "5": "bicycle", "ego_vehicle": "ego"}
    general = {"4": "two_wheeler", "5": "two_wheeler", "ego_vehicle": "ego"}
    rows = table.to_pandas()
    rows["label"], rows["general"] = rows["vehicle_id"].map(labels), rows["vehicle_id"].map(general).fillna("vehicle")
    rows = pd.concat([rows, rows[rows["vehicle_id"] == "5"].assign(vehicle_id="6", label="rider", general="person")])
    (tmp_path / "in").mkdir()
    changed = pa.Table.from_pandas(rows, preserve_index=False)
    pq.write_table(changed.replace_schema_metadata({"py123d": json.dumps(content)}), tmp_path / "in/pandaset_1.parquet")
    net = tmp_path / "made.net.xml"
    write_graph(LaneGraph(tuple(made_sources.lanes())), net)
    recording, *_ = imported(tmp_path / "in", tmp_path / "out", "--map", str(net))
    assert recording.header.licence == "CC BY 4.0" and "PandaSet" in recording.header.source
    kinds = recording.table.drop_duplicates("vehicle_id").set_index("vehicle_id")["kind"]
    ego = recording.header.notes["ego"]
    expected = {1: Kind.CAR, 3: Kind.TRUCK, 4: Kind.MOTORCYCLE, 5: Kind.BICYCLE, ego: Kind.CAR}
    assert kinds.to_dict() == expected


def test_what_is_no_data_set(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("nothing")
    with pytest.raises(InputError, match=r"none of its 1 files is of a known format: .*Argoverse 2.*--draft writes"):
        files_of(tmp_path)
    with pytest.raises(InputError, match="no such recording"):
        files_of(tmp_path / "absent")
    (tmp_path / "cut.tfrecord").write_bytes(made_sources.waymo_record(tmp_path / "w.tfrecord").read_bytes()[:-500])
    (tmp_path / "w.tfrecord").unlink()
    with pytest.raises(InputError, match="none of its"):
        files_of(tmp_path)


def test_the_scenario_names_its_files_relative_to_it(tmp_path: Path) -> None:
    *_, (scenario,) = imported(made_sources.commonroad(tmp_path / "a.xml"), tmp_path / "out")
    moved = (tmp_path / "out").rename(tmp_path / "elsewhere")
    fields = yaml.safe_load((moved / "scenarios" / scenario.name).read_text())
    assert fields["net"] == "../ZAM_Made-1_1_T-1.net.xml" and fields["recording"].startswith("../")
    assert Scenario.load(moved / "scenarios" / scenario.name).total_steps == 110
