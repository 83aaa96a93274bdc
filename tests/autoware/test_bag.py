"""Bags of Autoware become recordings: tracks, the ego at its box centre, and what traffic lights show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("autoware_perception_msgs", reason="Autoware's messages are not built (tools/interfaces.sh)")

from autoware_perception_msgs.msg import TrafficLightElement, TrafficLightGroup, TrafficLightGroupArray
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from litsim_autoware.messages import objects
from litsim_autoware.messages.vehicle import RearAxle
from litsim_data.cli import main
from litsim_data.generic.autoware_bag import VEHICLE_FILE, read_bag
from litsim_data.generic.bag_format import bag_file
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable, Kind
from litsim_sim.ros.definitions import definition
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording

ODOMETRY = "nav_msgs/msg/Odometry"
TRACKED = ("/perception/object_recognition/tracking/objects", "autoware_perception_msgs/msg/TrackedObjects")
PREDICTED = ("/perception/object_recognition/objects", "autoware_perception_msgs/msg/PredictedObjects")
LIGHTS = (
    "/perception/traffic_light_recognition/traffic_signals",
    "autoware_perception_msgs/msg/TrafficLightGroupArray",
)
INFO = """/**:
  ros__parameters: {wheel_radius: 0.4, wheel_base: 3.0, wheel_tread: 1.6, front_overhang: 1.0, rear_overhang: 0.8,
    left_overhang: 0.1, right_overhang: 0.1, vehicle_height: 2.0}
"""
BEGIN = 1_700_000_000.0  # [s]
EGO, FIRST, SECOND = 44, 12, 43


def scene(step: int, period: float) -> AgentTable:
    """A car, a pedestrian who comes at step 4, and the ego, which turns."""
    ids = [FIRST, SECOND, EGO] if step >= 4 else [FIRST, EGO]
    values = {
        FIRST: {"x": 10.0 + 20.0 * period * step, "y": -5.0, "yaw": 0.0, "speed": 20.0, "kind": Kind.CAR},
        SECOND: {"x": 3.0, "y": 7.0 + period * step, "yaw": 1.5, "speed": 1.0, "kind": Kind.PEDESTRIAN},
        EGO: {"x": 5.0 * period * step, "y": 1.0, "yaw": 0.2 * period * step, "speed": 5.0, "kind": Kind.CAR},
    }
    size = {FIRST: (4.5, 1.9), SECOND: (0.6, 0.6), EGO: (4.8, 1.8)}
    columns = {name: np.array([float(values[agent][name]) for agent in ids]) for name in ("x", "y", "yaw", "speed")}
    nothing = np.zeros(len(ids))
    return AgentTable(
        step,
        id=np.array(ids),
        kind=np.array([values[agent]["kind"] for agent in ids], np.uint8),
        controller=np.zeros(len(ids), np.uint8),
        **columns,
        acceleration=nothing,
        yaw_rate=nothing,
        length=np.array([size[agent][0] for agent in ids]),
        width=np.array([size[agent][1] for agent in ids]),
    )


def lights(step: int, stamp_ns: int) -> bytes:
    """Light 7023 turns green at step 10, after red and amber; light 9 flashes amber."""
    element = TrafficLightElement
    shown = [(element.RED, element.SOLID_ON), (element.AMBER, element.SOLID_ON)] if step in (8, 9) else []
    shown = shown or [(element.RED if step < 8 else element.GREEN, element.SOLID_ON)]
    groups = []
    for group, colours in ((7023, shown), (9, [(element.AMBER, element.FLASHING)])):
        circles = [element(color=colour, status=status, shape=element.CIRCLE) for colour, status in colours]
        groups.append(TrafficLightGroup(traffic_light_group_id=group, elements=circles))
    message = TrafficLightGroupArray(traffic_light_groups=groups)
    message.stamp.sec, message.stamp.nanosec = divmod(stamp_ns, 10**9)
    return bytes(serialize_message(message))


def write(
    folder: Path,
    kind: tuple[str, str],
    plugin: StoragePlugin,
    period: float = 0.1,
    steps: int = 21,
    pose: str = "/localization/kinematic_state",
) -> Path:
    """A bag of :func:`scene` and :func:`lights`, whose stamps are `period` seconds apart, as rosbag2 writes it."""
    store = get_typestore(Stores.EMPTY)
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, name in ((pose, ODOMETRY), kind, LIGHTS):
            store.register(get_types_from_msg(definition(name), name))
            connections[topic] = writer.add_connection(topic, name, typestore=store)
        for step in range(steps):
            table, stamp_ns = scene(step, period), round((BEGIN + period * step) * 1e9)
            write_objects = objects.tracked_objects if kind == TRACKED else objects.predicted_objects
            motion = RearAxle.of(table, EGO, 0.5 * 4.8 - 0.8)
            assert motion is not None
            data = {
                kind[0]: write_objects(table.take(table.id != EGO), stamp_ns),
                LIGHTS[0]: lights(step, stamp_ns),
                pose: motion.odometry(stamp_ns),
            }
            for topic, each in data.items():
                writer.write(connections[topic], stamp_ns, each)
    (folder / VEHICLE_FILE).write_text(INFO)
    return folder


def columns_of(recording: Recording, agent: int) -> pd.DataFrame:
    table = recording.table
    return table[table["vehicle_id"] == agent].set_index("frame")


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("kind", [TRACKED, PREDICTED])
def test_agents_are_where_they_were(kind: tuple[str, str], plugin: StoragePlugin, tmp_path: Path) -> None:
    recording = load_recording(bag_file(write(tmp_path / "bag", kind, plugin)))
    assert set(recording.table["vehicle_id"]) == {FIRST, SECOND, EGO}
    assert (recording.header.name, recording.header.notes["ego"]) == ("bag", EGO)  # the first id that is free
    for step in range(21):
        wanted = scene(step, 0.1)
        for row, agent in enumerate(wanted.id.tolist()):
            found = columns_of(recording, agent).loc[step]
            for name in ("x", "y", "yaw", "speed", "length", "width", "kind"):
                assert found[name] == pytest.approx(getattr(wanted, name)[row], abs=1e-6), (step, agent, name)
    assert columns_of(recording, SECOND).index[0] == 4


def test_other_rates_are_brought_to_10_hz(tmp_path: Path) -> None:
    recording = read_bag(
        bag_file(write(tmp_path / "bag", TRACKED, StoragePlugin.MCAP, period=0.03, steps=60))
    ).recording
    found = columns_of(recording, FIRST)
    assert found.index.tolist() == list(range(18))
    assert found["x"].to_numpy() == pytest.approx(10.0 + 20.0 * 0.1 * found.index.to_numpy(), abs=1e-4)


def test_lights_are_written_beside_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write(tmp_path / "bag", TRACKED, StoragePlugin.MCAP)
    main(["convert", str(bag), str(tmp_path / "out.parquet")])
    assert "out_signals.csv" in capsys.readouterr().out
    changes = pd.read_csv(tmp_path / "out_signals.csv", dtype={"group": str})
    assert changes.to_numpy().tolist() == [
        [0.0, "7023", "red"],
        [0.0, "9", "flashing_amber"],
        [0.8, "7023", "red_amber"],
        [1.0, "7023", "green"],
    ]
    assert Recording.read(tmp_path / "out.parquet").header.notes["ego_size"] == VEHICLE_FILE


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", TRACKED, StoragePlugin.MCAP)
    (path,) = bag.glob("*.mcap")
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(InputError, match=r"metadata.yaml: cannot be read as a bag"):
        read_bag(bag_file(bag))
    other = write(tmp_path / "other", TRACKED, StoragePlugin.MCAP, pose="/odometry/wheels")
    assert "ego" not in read_bag(bag_file(other)).recording.header.notes
    empty: dict[str, Any] = {"version": 9, "storage_plugin": StoragePlugin.MCAP}
    with Writer(tmp_path / "empty", **empty):
        pass
    with pytest.raises(InputError, match=r"no objects in .* and no ego in /localization/kinematic_state"):
        read_bag(bag_file(tmp_path / "empty"))
