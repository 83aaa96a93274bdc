"""Bags of Autoware pass the checks of tables: tracks, the ego at its box centre, what lights show."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rosbags.rosbag2 import StoragePlugin

import made_bags
from litsim_data.cli import main
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from made_bags import CAR, EGO, WALKER


def track(recording: Recording, agent: int) -> pd.DataFrame:
    table = recording.table
    return table[table["vehicle_id"] == agent].set_index("frame")


@pytest.mark.parametrize(
    ("kind", "package", "plugin"),
    [
        ("TrackedObjects", made_bags.PACKAGE, StoragePlugin.SQLITE3),
        ("PredictedObjects", made_bags.PACKAGE, StoragePlugin.MCAP),
        ("TrackedObjects", "autoware_auto_perception_msgs", StoragePlugin.MCAP),  # of Autoware before 2024
    ],
)
def test_agents_are_where_they_were(kind: str, package: str, plugin: StoragePlugin, tmp_path: Path) -> None:
    recording = load_recording(made_bags.write(tmp_path / "bag", kind, package=package, plugin=plugin))
    assert (recording.header.name, recording.header.notes["ego"]) == ("bag", EGO), "the first id that is free"
    for agent, begin, usual in ((CAR, 0, Kind.CAR), (WALKER, 4, Kind.PEDESTRIAN), (EGO, 0, Kind.CAR)):
        rows = track(recording, agent)
        assert rows.index.tolist() == list(range(begin, 31)) and set(rows["kind"]) == {usual}
        x, y, yaw, speed = np.array([made_bags.motion(agent, 0.1 * step) for step in rows.index]).T
        ahead = made_bags.REAR_TO_CENTRE * (agent == EGO)
        np.testing.assert_allclose(rows["x"], x + ahead * np.cos(yaw), atol=1e-6)
        np.testing.assert_allclose(rows["y"], y + ahead * np.sin(yaw), atol=1e-6)
        np.testing.assert_allclose(rows["yaw"], yaw, atol=1e-6)
        np.testing.assert_allclose(rows["speed"], speed, atol=1e-6)
        np.testing.assert_allclose(rows[["length", "width"]].iloc[0], made_bags.TRACKS[agent][4], atol=1e-6)


def test_other_rates_are_brought_to_10_hz(tmp_path: Path) -> None:
    rows = track(load_recording(made_bags.write(tmp_path / "bag", period=0.03, steps=60)), CAR)
    assert rows.index.tolist() == list(range(18))
    np.testing.assert_allclose(rows["x"], 20.0 + 0.8 * rows.index.to_numpy(), atol=1e-4)


def test_lights_and_the_fate_of_rows_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = made_bags.write(tmp_path / "bag", pose="/odometry/wheels").parent
    main(["convert", str(bag), str(tmp_path / "out.parquet")])
    told = capsys.readouterr().out
    assert "out_signals.csv" in told and "rows       58 read, 58 used, 58 at 10 Hz" in told
    assert "topic /odometry/wheels (nav_msgs/msg/Odometry, 31 messages) is not read" in told
    changes = pd.read_csv(tmp_path / "out_signals.csv", dtype={"group": str})
    assert changes.to_numpy().tolist() == [
        [0.0, "7023", "red"],
        [0.0, "9", "flashing_amber"],
        [0.8, "7023", "red_amber"],
        [1.0, "7023", "green"],
    ]
    assert "ego" not in Recording.read(tmp_path / "out.parquet").header.notes


def turned(message: Any, speed: float) -> None:
    """The car's rear is taken for its front."""
    about = message.objects[0].kinematics
    about.twist_with_covariance.twist.linear.x = speed
    about.pose_with_covariance.pose.orientation.z, about.pose_with_covariance.pose.orientation.w = 1.0, 0.0


@pytest.mark.parametrize("speed", [8.0, -8.0])
def test_front_and_rear_that_are_confused_are_put_right(speed: float, tmp_path: Path) -> None:
    recording = load_recording(made_bags.write(tmp_path / "bag", change=lambda message, _: turned(message, speed)))
    rows = track(recording, CAR)
    np.testing.assert_allclose(rows["yaw"], 0.0, atol=1e-6)
    np.testing.assert_allclose(rows["speed"], 8.0, atol=1e-6)
    assert recording.header.notes["headings_from_motion"] == [CAR]


def stamped(message: Any, step: int, until: int) -> None:
    if step < until:
        message.header.stamp.sec = message.header.stamp.nanosec = 0


def in_frame(message: Any, name: str) -> None:
    message.header.frame_id = name


def hurried(message: Any) -> None:
    message.objects[0].kinematics.twist_with_covariance.twist.linear.x = 14.0


def placed(message: Any, step: int) -> None:
    if step == 7:
        message.objects[0].kinematics.pose_with_covariance.pose.position.x = np.nan


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda m, step: stamped(m, step, 99), r"objects: field stamp is 0\.000 s in all of its 31 messages, expected"),
        (lambda m, step: stamped(m, step, 2), r"tracking/objects from 0\.000 to 1700000003\.000 s, .* by one clock"),
        (lambda m, _: in_frame(m, "base_link"), r"objects: header\.frame_id is 'base_link', expected 'map'"),
        (placed, r"tracking/objects, 12 at stamp 1700000000\.700: column 'pose\.position\.x' is empty or nan"),
        (lambda m, _: hurried(m), r"as column 'twist\.linear' says"),
    ],
)
def test_what_is_not_right_is_refused(change: Callable[[Any, int], None], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        load_recording(made_bags.write(tmp_path / "bag", change=change))


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    path = made_bags.write(tmp_path / "bag")
    (content,) = path.parent.glob("*.mcap")
    content.write_bytes(content.read_bytes()[:-300])
    with pytest.raises(InputError, match=r"metadata.yaml: cannot be read as a bag"):
        load_recording(path)
    empty = made_bags.write(tmp_path / "empty", steps=0)
    with pytest.raises(InputError, match=r"no objects in .* and no ego in /localization/kinematic_state"):
        load_recording(empty)
