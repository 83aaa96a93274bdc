"""Scenario files: the packaged ones work, travel as text, and every slip in one is named."""

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from litsim_data import cli as data
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, STEP_S, Controller, Kind
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario, packaged, packaged_scenarios

EMBEDDED = load_recording(packaged("scenarios/us101_like.parquet"))


@pytest.fixture(scope="module")
def demo() -> Scenario:
    return Scenario.load("demo")


@pytest.fixture
def fields(tmp_path: Path) -> dict[str, Any]:
    """Fields of a sound scenario of 8 s, whose recording lies in tmp_path."""
    table = EMBEDDED.table
    Recording.of_table(EMBEDDED.header, table[table["frame"] <= 80]).write(tmp_path / "part.parquet")
    return {"name": "part", "recording": "part.parquet", "net": "us101_like", "ego": 7, "simulation_s": 5.0}


def saved(tmp_path: Path, fields: dict[str, Any]) -> Path:
    path = tmp_path / "part.yaml"
    path.write_text(yaml.safe_dump(fields, sort_keys=False))
    return path


def refusal(tmp_path: Path, fields: dict[str, Any]) -> str:
    path = saved(tmp_path, fields)
    with pytest.raises(InputError) as caught:
        Scenario.load(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


# Packaged scenarios


def test_demo(demo: Scenario) -> None:
    assert packaged_scenarios() == ("demo", "us101_0750")
    assert (demo.name, demo.ego_id, demo.roi_m, demo.seed) == ("demo", 6, 30.0, 0)
    assert (demo.history_steps, demo.total_steps, demo.shortened, demo.start_frame) == (30, 280, False, 0)
    assert demo.net_path.name == "us101_like.net.xml"
    row = demo.log.row(demo.ego_id)
    assert demo.log.valid[row].all()
    at = demo.lane_map.nearest(demo.log.x[row], demo.log.y[row], demo.log.yaw[row])
    lanes = [demo.lane_map.lanes[i] for i in at.lane]
    assert all(lane.right and not lane.left for lane in lanes)
    frames = demo.recording.table.groupby("vehicle_id")["frame"]
    stay = (frames.min() == 0) & (frames.max() == demo.total_steps)
    assert set(demo.egos) == set(stay.index[stay])
    assert demo.egos[0] == demo.ego_id
    assert demo.tuning_egos == ()
    assert set(demo.egos) < set(demo.possible_egos) < set(demo.log.ids.tolist())


@pytest.mark.data
def test_us101(real_data) -> None:
    real_data()
    scenario = Scenario.load("us101_0750")
    assert (scenario.history_steps, scenario.total_steps, scenario.shortened) == (30, 227, True)
    assert len(scenario.egos) == 20
    assert scenario.ego_id == scenario.egos[0]
    first, last = scenario.log.first_step, scenario.log.last_step
    stay = scenario.log.ids[(first == 0) & (last >= 60)]
    drawn = np.random.default_rng(0).choice(stay, 20, replace=False).tolist()
    assert scenario.egos == tuple(drawn)
    assert set(scenario.tuning_egos) == set(stay.tolist()) - set(drawn)
    assert (
        scenario.lane_map.inside_road(scenario.log.x[scenario.log.valid], scenario.log.y[scenario.log.valid]).mean()
        > 0.97
    )
    again = Scenario.from_yaml(scenario.to_yaml(), "bag")
    assert again.file == scenario.file
    pd.testing.assert_frame_equal(again.recording.table, scenario.recording.table, check_exact=True)


@pytest.mark.data
def test_us101_of_the_official_file_as_documented(real_data, tmp_path: Path) -> None:
    """The windows, written as NGSIM's own text file, give the scenario of the same vehicles at the same places."""
    windows = pd.read_parquet(real_data())
    windows = windows[(windows["src"] < 2) & windows["frame"].between(316, 543)]
    windows = windows[windows["local_y_m"].between(180, 415)].sort_values(["vehicle_id", "frame"])
    metres = ["local_x_m", "local_y_m", "global_x_m", "global_y_m", "length_m", "width_m", "speed_mps", "accel_mps2"]
    feet = (windows[metres] / 0.3048).round(3)
    rows = windows[["vehicle_id", "frame"]].assign(
        total=1, time=1118846978900 + 100 * windows["frame"].astype(np.int64)
    )
    rows = pd.concat(
        [rows, feet[metres[:6]], windows[[]].assign(kind=2), feet[metres[6:]], windows["lane_est"]], axis=1
    )
    rows.assign(a=0, b=0, c=0, d=0).to_csv(tmp_path / "text.txt", sep=" ", header=False, index=False)
    (tmp_path / "ngsim").mkdir()
    data.main(["import", str(tmp_path / "text.txt"), str(tmp_path / "ngsim" / "us101_0750.parquet")])
    page = Path(__file__).parents[3] / "docs" / "data.md"
    (documented,) = re.findall(
        r"```yaml\n(name: us101_0750_official\n.*?)```", page.read_text(encoding="utf-8"), re.DOTALL
    )
    (tmp_path / "official.yaml").write_text(documented)
    made, usual = Scenario.load(str(tmp_path / "official.yaml")), Scenario.load("us101_0750")
    assert (made.egos, made.history_steps, made.total_steps) == (usual.egos, usual.history_steps, usual.total_steps)
    both = made.recording.table.merge(usual.recording.table, on=["vehicle_id", "frame"])
    assert len(both) > 0.99 * len(usual.recording.table)
    assert np.quantile(np.hypot(both["x_x"] - both["x_y"], both["y_x"] - both["y_y"]), 0.95) < 0.3


@pytest.mark.parametrize("value", [None, "/nowhere"])
def test_real_data_that_is_absent(monkeypatch: pytest.MonkeyPatch, value: str | None) -> None:
    monkeypatch.delenv("LITSIM_DATA", raising=False)
    if value:
        monkeypatch.setenv("LITSIM_DATA", value)
    with pytest.raises(InputError, match=r"field recording: .*LITSIM_DATA.*scenario demo needs none"):
        Scenario.load("us101_0750")


# Loading


def test_scenarios_travel_as_text(demo: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # paths must not depend on where a node was started
    again = Scenario.from_yaml(demo.to_yaml(), "topic run_info")
    assert again.file == demo.file
    assert again.to_yaml() == demo.to_yaml()
    for name, value in vars(demo.log).items():
        np.testing.assert_array_equal(getattr(again.log, name), value)


def test_overrides(demo: Scenario) -> None:
    other = Scenario.load("demo", ego=13, seed=5, roi_m=20.0, history_s=None)
    assert (other.ego_id, other.seed, other.roi_m) == (13, 5, 20.0)
    assert Scenario.from_yaml(other.to_yaml(), "x").file == other.file
    assert other.file == demo.file.model_copy(update={"ego": 13, "seed": 5, "roi_m": 20.0})
    slow = Scenario.load("demo", vehicle={"delay_s": 0.2})
    assert (slow.vehicle.delay_s, demo.vehicle) == (0.2, VehicleModel())
    assert Scenario.from_yaml(slow.to_yaml(), "x").vehicle == slow.vehicle
    with pytest.raises(InputError, match="field egoo: Extra inputs are not permitted"):
        Scenario.load("demo", egoo=1)


def test_files_beside_the_yaml_and_elsewhere(
    tmp_path: Path, fields: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = Scenario.load(saved(tmp_path, fields))
    assert (scenario.total_steps, scenario.shortened, scenario.egos) == (80, False, (7,))
    (tmp_path / "own.net.xml").write_text(packaged("nets/us101_like.net.xml").read_text())
    assert Scenario.load(saved(tmp_path, fields | {"net": "own.net.xml"})).net_path == tmp_path / "own.net.xml"
    monkeypatch.setenv("LITSIM_DATA", str(tmp_path))
    for spelling in ("$LITSIM_DATA/part.parquet", "${LITSIM_DATA}/part.parquet", str(tmp_path / "part.parquet")):
        assert Scenario.load(saved(tmp_path, fields | {"recording": spelling})).file.recording == str(
            tmp_path / "part.parquet"
        )


def test_start_length_and_crop(tmp_path: Path, fields: dict[str, Any]) -> None:
    scenario = Scenario.load(saved(tmp_path, fields | {"start_frame": 20, "history_s": 2.0, "simulation_s": 1.5}))
    assert (scenario.history_steps, scenario.total_steps, scenario.shortened) == (20, 35, False)
    assert scenario.recording.table["frame"].agg(["min", "max"]).tolist() == [20, 55]
    x = EMBEDDED.table.set_index(["vehicle_id", "frame"])["x"]
    assert scenario.log.x[scenario.log.row(7), 3] == x[7, 23]
    longer = Scenario.load(saved(tmp_path, fields | {"simulation_s": 25.0}))
    assert (longer.total_steps, longer.shortened) == (80, True)
    cropped = Scenario.load(saved(tmp_path, fields | {"crop": {"x": [120, 300], "frame": [10, 70]}}))
    assert (cropped.start_frame, cropped.total_steps) == (10, 60)
    assert cropped.log.x.max() <= 300


# Failures


def test_no_such_scenario(tmp_path: Path) -> None:
    for name in ("dema", tmp_path / "absent.yaml"):
        with pytest.raises(InputError, match="no such scenario; expected a YAML file, or one of demo, us101_0750"):
            Scenario.load(name)
    with pytest.raises(InputError, match=f"^{tmp_path}: is a folder, expected a file$"):
        Scenario.load(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: [", "malformed YAML"),
        ("name: a\n\tego: 3\n", "malformed YAML"),
        ("just words", "expected fields such as name"),
        ("", "expected fields such as name"),
        ("litsim_segments: 1", "the manifest of a folder of segments, expected a scenario"),
    ],
)
def test_malformed_yaml(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"bad\.yaml: {message}"):
        Scenario.load(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"bad\.yaml"):
        Scenario.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"egoo": 1}, "line 6, field egoo: Extra inputs are not permitted"),
        ({"ego": "seven"}, "line 4, field ego: Input should be a valid integer"),
        ({"roi_m": -1.0}, "field roi_m: Input should be greater than 0"),
        ({"crop": {"frame": [1]}}, "field crop.frame: List should have at least 2 items"),
        ({"seed": 1.5}, "field seed"),
        ({"ego": 999}, "field ego: no vehicle 999; present at the start: 1, 2, 3"),
        ({"ego": 90}, "field ego: vehicle 90 is present in steps"),
        ({"egos": [7, 999]}, "field egos: no vehicle 999"),
        ({"egos": [7, 6], "tuning": [6]}, "field tuning repeats [6] of field egos"),
        ({"start_frame": 81}, "start_frame is 81, expected one of 0 to 80"),
        ({"start_frame": 50}, "recording is too short: 30 steps"),
        ({"recording": "absent.parquet"}, "field recording: "),
        ({"recording": "a\0b"}, "field recording: expected the path of a file, found 'a\\x00b'"),
        ({"recording": ""}, "field recording: expected the path of a file"),
        ({"net": "a\0b"}, "field net: expected the path of a file"),
        ({"net": "us102_like"}, "no such net; expected a file, or one of i80, urban_like, us101, us101_like"),
        ({"name": "../../x"}, "field name: expected up to 100 letters, digits and . _ + = -"),
        ({"name": ".."}, "field name: expected"),
        ({"name": "a" * 101}, "field name: expected"),
        ({"simulation_s": float("inf")}, "field simulation_s: Input should be a finite number"),
        ({"history_s": float("nan")}, "field history_s: Input should be a finite number"),
        ({"simulation_s": 0.05}, "field simulation_s: Input should be greater than or equal to 0.1, found 0.05"),
        ({"history_s": 1e300}, "field history_s: Input should be less than or equal to 86400"),
        ({"roi_m": float("inf")}, "field roi_m: Input should be a finite number"),
        ({"vehicle": {"lag_s": float("inf")}}, "field vehicle.lag_s: Input should be a finite number"),
        ({"seed": 10**40}, "field seed: Input should be less than 18446744073709551616"),
        ({"vehicle": {"delay_s": 0.25}}, "field vehicle: delay_s is 0.25, expected a multiple of 0.1 s"),
        ({"vehicle": {"wheels": 4}}, "field vehicle: wheels is unknown, expected some of "),
        ({"vehicle": {"lag_s": "much"}}, "field vehicle.lag_s: Input should be a valid number"),
    ],
)
def test_fields_that_do_not_fit(tmp_path: Path, fields: dict[str, Any], change: dict[str, Any], message: str) -> None:
    assert message in refusal(tmp_path, fields | change)


def test_possible_egos_are_those_that_are_not_refused(demo: Scenario) -> None:
    for agent in (*demo.possible_egos[::10], 90):
        if agent in demo.possible_egos:
            assert Scenario.load("demo", ego=agent).ego_id == agent
        else:
            with pytest.raises(InputError, match=f"vehicle {agent} is present in steps"):
                Scenario.load("demo", ego=agent)


def test_net_that_does_not_cover_the_recording(tmp_path: Path, fields: dict[str, Any]) -> None:
    table = EMBEDDED.table[EMBEDDED.table["frame"] <= 80]
    Recording.of_table(EMBEDDED.header, table.assign(y=table["y"] + 12.0)).write(tmp_path / "part.parquet")
    message = refusal(tmp_path, fields)
    assert "net us101_like.net.xml does not cover the recording" in message
    assert "expected 90%" in message
    assert "the net x 0 to 640, y -29 to -2 m" in message
    assert "expected 100%" in refusal(tmp_path, fields | {"coverage_min": 1})
    share = Scenario.load(saved(tmp_path, fields | {"coverage_min": 0.0})).coverage
    assert 0.0 < share < 0.9, "what is demanded is a field of the scenario, from 0 to 1"
    for share in (-0.1, 1.1, float("nan")):
        assert "field coverage_min" in refusal(tmp_path, fields | {"coverage_min": share})


def test_a_net_that_leads_the_other_way(make_scenario: Any, track: Any, lane_centres: Any) -> None:
    along, against = track(1, x=50.0, y=lane_centres[1]), track(2, x=150.0, y=lane_centres[1], yaw=np.pi)
    assert make_scenario(along, against).coverage == 1.0, "somebody may drive the wrong way"
    with pytest.raises(InputError, match=r"other way than the recording: 100\.0% of the poses of moving vehicles"):
        make_scenario(replace(against, id=1))


def test_pedestrians_and_cyclists_keep_to_no_lanes_and_are_no_egos(
    make_scenario: Any, track: Any, lane_centres: Any
) -> None:
    walkers = [track(n, x=20.0 * n, y=60.0, kind=kind) for n, kind in ((8, Kind.PEDESTRIAN), (9, Kind.BICYCLE))]
    made = make_scenario(track(1, x=50.0, y=lane_centres[1]), *walkers)
    assert made.coverage == 1.0 and made.possible_egos == (1,)
    with pytest.raises(InputError, match="field egos: 8 is a pedestrian, expected a vehicle"):
        make_scenario(track(1, x=50.0, y=lane_centres[1]), *walkers, egos=[1, 8])
    with pytest.raises(InputError, match="does not cover the recording: 33"):
        make_scenario(track(1, x=50.0), *(replace(walker, kind=Kind.CAR) for walker in walkers))


# The log


def test_log_holds_what_was_recorded(demo: Scenario) -> None:
    log, rows = demo.log, load_recording(packaged("scenarios/demo.parquet")).table.groupby("frame").get_group(123)
    table = log.table(123)
    assert table.step == 123
    assert (table.controller == Controller.LOG).all()
    for field in ARRAY_FIELDS:
        assert getattr(table, field).dtype == DTYPES[field]
        assert len(getattr(table, field)) == len(rows)
    assert table.id.tolist() == rows["vehicle_id"].tolist() == sorted(rows["vehicle_id"])
    for field in ("x", "y", "yaw", "speed", "acceleration", "length", "width", "kind"):
        np.testing.assert_allclose(getattr(table, field), rows[field], atol=1e-12)
    assert (log.x[~log.valid] == 0).all()
    assert (log.valid.sum(axis=1) == log.last_step - log.first_step + 1).all()
    assert len(log.table(-1)) == len(log.table(log.steps)) == 0


def test_yaw_rate_does_not_jump_where_the_heading_wraps() -> None:
    frames = np.arange(5)
    yaw = np.array([3.0, 3.1, -3.0832, -2.9832, -2.8832])  # half a turn at 1 rad/s, over pi
    columns = {"x": 0.0, "y": 0.0, "speed": 1.0, "acceleration": 0.0, "length": 4.0, "width": 2.0, "kind": 0, "lane": 1}
    table = pd.DataFrame({"vehicle_id": 4, "frame": frames + 10, "yaw": yaw, **columns})
    single = pd.DataFrame({"vehicle_id": 9, "frame": [12], "yaw": 1.0, **columns})
    recording = Recording.from_table(RecordingHeader("made"), pd.concat([table, single]), "made")
    log = Log.from_recording(recording, 10, 5)
    np.testing.assert_allclose(log.yaw_rate[0], 1.0, atol=1e-3)
    assert log.yaw_rate[1].tolist() == [0.0] * 5
    assert (log.first_step.tolist(), log.last_step.tolist()) == ([0, 2], [4, 2])
    assert log.yaw_rate[0, 1] == pytest.approx((yaw[1] - yaw[0]) / STEP_S)
    assert (log.row(4), log.row(9), log.row(5), log.row(10)) == (0, 1, -1, -1)


def test_of_the_vehicle_only_what_is_given_is_replaced(tmp_path: Path, fields: dict[str, Any]) -> None:
    path = saved(tmp_path, fields | {"vehicle": {"jerk_max": 10.0, "lag_s": 0.3}})
    assert Scenario.load(path, vehicle={"lag_s": 0.1}).vehicle == VehicleModel(jerk_max=10.0, lag_s=0.1)
    assert Scenario.load(path).vehicle == VehicleModel(jerk_max=10.0, lag_s=0.3)


def test_a_scenario_around_another_ego_is_the_one_that_is_loaded_so() -> None:
    demo = Scenario.load("demo")
    other, loaded = demo.around(demo.egos[1], 5), Scenario.load("demo", ego=demo.egos[1], seed=5)
    assert other.file == loaded.file and other.log is demo.log
    assert (demo.ego_id, demo.seed) == (demo.file.ego, demo.file.seed) != (other.ego_id, other.seed)
    assert demo.around(None, None).file == demo.file
    with pytest.raises(InputError, match="field ego: no vehicle 99999"):
        demo.around(99999, None)
    with pytest.raises(InputError, match="field seed"):
        demo.around(None, -1)


NUMBERS = ("start_frame", "history_s", "simulation_s", "roi_m", "seed", "ego", "end_after_contact_s", "coverage_min")


@pytest.mark.parametrize("value", [1e308, 5e-324, -(2**63), 10**30, 0])
def test_numbers_at_their_extremes_are_taken_or_refused(tmp_path: Path, fields: dict[str, Any], value: float) -> None:
    """They are never a traceback: of an overflow, of memory that is not there, of an index far away."""
    phase = {"duration_s": value, "states": {"a": "green"}}
    sources = [
        {"program": {"phases": [phase]}},
        {"program": {"offset_s": value, "phases": [phase | {"duration_s": 10.0}]}},
        {"changes": [[value, "a", "green"]]},
    ]
    for change in (
        *({name: value} for name in NUMBERS),
        *({"vehicle": {name: value}} for name in VehicleModel.__dataclass_fields__),
        *({"signals": {"groups": {"a": ["through_0"]}} | source} for source in sources),
        {"egos": [value]},
        {"crop": {"x": [-1e308, value]}},
    ):
        with suppress(InputError):
            Scenario.load(saved(tmp_path, fields | change))
