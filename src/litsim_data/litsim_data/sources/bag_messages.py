"""Messages of Autoware in ROS 2 bags: objects and the ego as one table, and the changes of traffic lights.

Types are decoded by the definitions in the bag, MCAP or SQLite, so that none needs to be installed.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from math import atan2, copysign, cos, hypot, sin
from pathlib import Path
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError
from rosbags.typesys import Stores, get_typestore

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.generic.mapping import Mapping
from litsim_data.sources.source import Scene, SignalChange
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_NS
from litsim_sim.core.signals import SignalState
from litsim_sim.ego_port.object_ids import agent_of
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.record.decoding import UNDECODABLE, check_size

VEHICLE_FILE = "vehicle_info.param.yaml"
PACKAGES = ("autoware_perception_msgs", "autoware_auto_perception_msgs")
"""Packages whose lists of objects have one layout: of today's Autoware, and of that before 2024."""
OBJECTS = {
    "TrackedObjects": "/perception/object_recognition/tracking/objects",
    "PredictedObjects": "/perception/object_recognition/objects",
}
"""Lists of objects with ids, the first of which counts, and the usual topic of each."""
ODOMETRY, POSE_TOPIC = "nav_msgs/msg/Odometry", "/localization/kinematic_state"
SIGNALS = "autoware_perception_msgs/msg/TrafficLightGroupArray"
SIGNALS_TOPIC = "/perception/traffic_light_recognition/traffic_signals"
MAP_FRAME = "map"
EGO = "ego"
LABELS = ("unknown", "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian")
"""What the numbers of an ObjectClassification mean."""
KINDS = {label: label for label in LABELS} | {"bus": "truck", "trailer": "truck"}
POLYGON, CIRCLE = 2, 1  # of Shape, of TrafficLightElement
OFF, ON, FLASHING = 1, 2, 3
COLOURS = {
    (1, ON): SignalState.RED,
    (1, FLASHING): SignalState.FLASHING_RED,
    (2, ON): SignalState.AMBER,
    (2, FLASHING): SignalState.FLASHING_AMBER,
    (3, ON): SignalState.GREEN,
}
"""What an element of a light shows, by its colour and status."""
COLUMNS = {
    "vehicle_id": "object_id",
    "time": "header.stamp",
    "x": "pose.position.x",
    "y": "pose.position.y",
    "yaw": "pose.orientation",
    "speed": "twist.linear",
    "length": "shape.dimensions.x",
    "width": "shape.dimensions.y",
    "kind": "classification",
}
"""Fields of an object by our names."""
FASTER, SLACK_NS = 10, 60 * 10**9  # times as fast as the bag was recorded that a simulator's clock may run, and [ns]


class VehicleInfo(BaseModel):
    """Size of the ego [m], as in Autoware's ``vehicle_info.param.yaml``; by default that of its sample vehicle."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    wheel_base: float = Field(default=2.79, gt=0.0)
    wheel_tread: float = Field(default=1.64, gt=0.0)
    front_overhang: float = Field(default=1.0, ge=0.0)
    rear_overhang: float = Field(default=1.1, ge=0.0)
    left_overhang: float = Field(default=0.128, ge=0.0)
    right_overhang: float = Field(default=0.128, ge=0.0)

    @property
    def length(self) -> float:
        """Length of the box [m]."""
        return self.rear_overhang + self.wheel_base + self.front_overhang

    @property
    def width(self) -> float:
        """Width of the box [m]."""
        return self.left_overhang + self.wheel_tread + self.right_overhang


class _Parameters(BaseModel):
    model_config = ConfigDict(extra="ignore")

    ros__parameters: VehicleInfo


class _VehicleFile(BaseModel):
    """A file of parameters for all nodes."""

    model_config = ConfigDict(extra="forbid")

    all_nodes: _Parameters = Field(alias="/**")


class _Row(NamedTuple):
    """An agent at the time of a message, `stamp` [ns]; fields are those of COLUMNS, and the topic."""

    name: str
    stamp: int
    x: float
    y: float
    yaw: float
    speed: float
    length: float
    width: float
    kind: str
    z: float
    topic: str


@dataclass(frozen=True)
class _Messages(LoadedTable):
    """The agents of all messages; errors name topic, agent and stamp.

    Attributes:
        zero_ns: stamp that the times of the table count from [ns].
    """

    zero_ns: int = 0

    def place(self, *rows: int) -> str:
        """See :class:`LoadedTable`."""
        places = []
        for topic, agent, time in (
            self.table[["topic", COLUMNS["vehicle_id"], COLUMNS["time"]]]
            .iloc[[row - 1 for row in rows]]
            .itertuples(index=False)
        ):
            places.append(f"topic {topic}, {agent} at stamp {1e-9 * (time + self.zero_ns):.3f}")
        return f"{self.path}: {' and '.join(places)}"


def read_scene(path: Path, name: str, source: Path) -> Scene:
    """Returns the traffic in the bag `source`, by the stamps of its messages, as a scene `name` of the file `path`.

    The ego's box is that of the file `vehicle_info.param.yaml` beside the bag, else of Autoware's sample vehicle.

    Raises:
        InputError: the bag cannot be read, holds neither objects nor the ego, or stamps or frames cannot be used.
    """
    info = path.parent / VEHICLE_FILE
    vehicle = read_yaml(info, _VehicleFile).all_nodes.ros__parameters if info.is_file() else VehicleInfo()
    rows: list[_Row] = []
    shown: dict[str, list[tuple[int, str]]] = {}
    stamps: dict[str, list[int]] = {}
    try:
        with AnyReader([source], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            chosen, length_ns = _chosen(reader, path), reader.duration
            notes = _unread(reader, chosen)
            for connection, _, data in reader.messages(chosen):
                check_size(reader.typestore, connection.msgtype, data)
                message = reader.deserialize(data, connection.msgtype)
                is_lights = connection.msgtype == SIGNALS
                stamps.setdefault(connection.topic, []).append(
                    _ns(message.stamp if is_lights else message.header.stamp)
                )
                if is_lights:
                    _take_lights(shown, message)
                else:
                    _check_frame(message, connection.topic, path)
                    rows += _objects(message, connection.topic, vehicle)
    except (AnyReaderError, ReaderError, sqlite3.Error, OSError, *UNDECODABLE) as error:
        raise InputError(f"{path}: cannot be read as a bag: {' '.join(str(error).split())}") from error
    if not rows:
        held = f"; {'; '.join(notes)}" if notes else ""
        raise InputError(f"{path}: no objects in {' or '.join(OBJECTS.values())}, and no ego in {POSE_TOPIC}{held}")
    table = pd.DataFrame(rows, columns=[*COLUMNS.values(), "z", "topic"])
    _check_clock(stamps, length_ns, path)
    zero_ns = int(table[COLUMNS["time"]].min()) // STEP_NS * STEP_NS
    table[COLUMNS["time"]] -= zero_ns  # seconds since 1970 as floating-point numbers would be off by 0.1 us
    tracks = _Messages((), tuple(table.columns), path, table, zero_ns)
    kinds = {kind: KINDS.get(kind, "unknown") for kind in table[COLUMNS["kind"]].unique()}
    mapping = Mapping.of_scene(COLUMNS, kinds, units={"time": "ns"}, accept=["size"])  # trackers guess sizes
    has_ego = bool((table[COLUMNS["vehicle_id"]] == EGO).any())
    if has_ego and not info.is_file():
        notes.append(f"the ego has the size of Autoware's sample vehicle, as no {VEHICLE_FILE} is beside the bag")
    return Scene(
        name,
        tracks,
        mapping,
        signals=_changes(shown, zero_ns),
        ego=EGO if has_ego else None,
        notes=tuple(notes),
    )


def _chosen(reader: AnyReader, path: Path) -> list[Connection]:
    """Returns the connections that are read.

    Raises:
        InputError: of a type there is no definition, or there are several topics and none is the usual one.
    """
    listed = [f"{package}/msg/{name}" for name in OBJECTS for package in PACKAGES]
    held = [kind for kind in listed if any(channel.msgtype == kind for channel in reader.connections)][:1]
    usual = {kind: OBJECTS[kind.rpartition("/")[2]] for kind in held} | {SIGNALS: SIGNALS_TOPIC, ODOMETRY: POSE_TOPIC}
    topics = {topic for kind, name in usual.items() if (topic := _topic(reader, kind, name, path))}
    chosen = [channel for channel in reader.connections if channel.topic in topics and channel.msgtype in usual]
    for channel in chosen:
        if channel.msgtype not in reader.typestore.fielddefs:
            raise InputError(
                f"{path}: topic {channel.topic}: the bag has no definition of {channel.msgtype}, "
                "as bags before ROS 2 Iron; convert it with `ros2 bag convert` where Autoware is installed"
            )
    return chosen


def _topic(reader: AnyReader, kind: str, usual: str, path: Path) -> str | None:
    """Returns the topic of a type: the usual one, else the only one, of odometry none; None without any."""
    names = sorted({connection.topic for connection in reader.connections if connection.msgtype == kind})
    if usual in names or kind == ODOMETRY:
        return usual if usual in names else None
    if len(names) < 2:
        return next(iter(names), None)
    raise InputError(f"{path}: {kind} on {', '.join(names)}, expected it on {usual}, or on one topic")


def _unread(reader: AnyReader, chosen: list[Connection]) -> list[str]:
    """Returns a sentence on each topic of perception or odometry whose messages are not read."""
    topics = {channel.topic for channel in chosen}
    others = {
        (channel.topic, channel.msgtype): channel.msgcount
        for channel in reader.connections
        if channel.topic not in topics and ("perception_msgs/" in channel.msgtype or channel.msgtype == ODOMETRY)
    }
    return [f"topic {topic} ({kind}, {count} messages) is not read" for (topic, kind), count in sorted(others.items())]


def _check_frame(message: Any, topic: str, path: Path) -> None:
    """Refuses positions that are not in frame map.

    Raises:
        InputError: they are in another frame.
    """
    frame = message.header.frame_id
    if frame.removeprefix("/") != MAP_FRAME:
        raise InputError(
            f"{path}: topic {topic}: header.frame_id is {frame!r}, expected {MAP_FRAME!r}: positions of another frame, "
            "such as one that moves with the ego, are none on the map"
        )


def _check_clock(stamps: dict[str, list[int]], length_ns: int, path: Path) -> None:
    """Refuses stamps [ns], by topic, that stand still or are by different clocks, in a bag of `length_ns` [ns].

    Raises:
        InputError: they do, or are.
    """
    for topic, times in stamps.items():
        if len(times) > 1 and min(times) == max(times):
            raise InputError(
                f"{path}: topic {topic}: field stamp is {1e-9 * times[0]:.3f} s in all of its {len(times)} messages, "
                "expected the time of each"
            )
    begin, end = min(map(min, stamps.values())), max(map(max, stamps.values()))
    if end - begin > FASTER * length_ns + SLACK_NS:
        spans = [f"{topic} from {1e-9 * min(its):.3f} to {1e-9 * max(its):.3f} s" for topic, its in stamps.items()]
        raise InputError(
            f"{path}: field stamp of {', '.join(spans)}, in a bag of {1e-9 * length_ns:.1f} s: expected times by one "
            "clock"
        )


def _objects(message: Any, topic: str, vehicle: VehicleInfo) -> Iterator[_Row]:
    """Yields the objects of a message: of a list, or the ego, whose pose is that of its rear axle."""
    stamp = _ns(message.header.stamp)
    if not hasattr(message, "objects"):
        place, yaw = message.pose.pose.position, _yaw(message.pose.pose.orientation)
        ahead = 0.5 * vehicle.length - vehicle.rear_overhang
        centre = place.x + ahead * cos(yaw), place.y + ahead * sin(yaw)
        size = vehicle.length, vehicle.width
        yield _Row(EGO, stamp, *centre, yaw, _speed(message.twist.twist), *size, "car", place.z, topic)
        return
    for detected in message.objects:
        about = detected.kinematics
        initial = "initial_" if hasattr(about, "initial_pose_with_covariance") else ""
        pose = getattr(about, f"{initial}pose_with_covariance").pose
        speed = _speed(getattr(about, f"{initial}twist_with_covariance").twist)
        likely = max(detected.classification, key=lambda label: label.probability, default=None)
        label = 0 if likely is None else int(likely.label)
        kind = LABELS[label] if label < len(LABELS) else f"label {label}"
        uuid = bytes(detected.object_id.uuid)
        agent = agent_of(uuid)
        name = str(UUID(bytes=uuid)) if agent is None else str(agent)
        place = pose.position
        yield _Row(
            name, stamp, place.x, place.y, _yaw(pose.orientation), speed, *_size(detected.shape), kind, place.z, topic
        )


def _take_lights(shown: dict[str, list[tuple[int, str]]], message: Any) -> None:
    """Adds the changes that a message tells to what each traffic light has `shown`, with the time [ns]."""
    for light in message.traffic_light_groups:
        state = _state(light.elements).name.lower()
        changes = shown.setdefault(str(light.traffic_light_group_id), [])
        if not changes or changes[-1][1] != state:
            changes.append((_ns(message.stamp), state))


def _changes(shown: dict[str, list[tuple[int, str]]], zero_ns: int) -> tuple[SignalChange, ...]:
    """Returns the changes of all lights, with times [s] from `zero_ns` on."""
    return tuple(
        sorted(
            (round(1e-9 * (time - zero_ns), 3), group, state)
            for group, changes in shown.items()
            for time, state in changes
        )
    )


def _size(shape: Any) -> tuple[float, float]:
    """Returns length and width of a shape [m]: those of its box, or of the box around its polygon."""
    corners = shape.footprint.points
    if shape.type == POLYGON and len(corners) > 2:
        extent = np.ptp([(corner.x, corner.y) for corner in corners], axis=0)
        return float(extent[0]), float(extent[1])
    return shape.dimensions.x, shape.dimensions.y


def _state(elements: list[Any]) -> SignalState:
    """Returns what a light shows by its circles, or by its first arrow that is on."""
    if not elements:
        return SignalState.UNAVAILABLE
    lit = {(element.shape, element.color): element for element in elements if element.status in (ON, FLASHING)}
    circles = [element for (shape, _), element in lit.items() if shape == CIRCLE]
    if {element.color for element in circles} >= {1, 2}:
        return SignalState.RED_AMBER
    for element in circles or lit.values():
        if (shown := COLOURS.get((int(element.color), int(element.status)))) is not None:
            return shown
    return SignalState.DARK if all(element.status == OFF for element in elements) else SignalState.UNAVAILABLE


def _speed(twist: Any) -> float:
    """Returns the speed of an object along its heading [m/s]."""
    return copysign(hypot(twist.linear.x, twist.linear.y), twist.linear.x)


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _yaw(turn: Any) -> float:
    return atan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2))
