"""ROS 2 bags of Autoware as recordings: tracked or predicted objects, the ego's odometry, traffic signals.

Types are decoded by the definitions in the bag, MCAP or SQLite, so that none needs to be installed.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import atan2, hypot
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError
from rosbags.typesys import Stores, get_typestore

from litsim_data.generic.bag_format import METADATA_FILE
from litsim_data.generic.counts import Counts
from litsim_data.generic.resampling import PIECE, resampled, split
from litsim_sim.core.errors import InputError
from litsim_sim.core.object_ids import agent_of
from litsim_sim.core.scene import STEP_NS, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.io.files import replacing
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.record.decoding import UNDECODABLE
from litsim_sim.scenario.recording import BOUNDS, COLUMNS, Recording, RecordingHeader

VEHICLE_FILE, SAMPLE_VEHICLE = "vehicle_info.param.yaml", "Autoware's sample vehicle"
OBJECTS = {
    "autoware_perception_msgs/msg/TrackedObjects": "/perception/object_recognition/tracking/objects",
    "autoware_perception_msgs/msg/PredictedObjects": "/perception/object_recognition/objects",
}
"""Types of lists of objects with ids, the first of which counts, and the usual topic of each."""
ODOMETRY, POSE_TOPIC = "nav_msgs/msg/Odometry", "/localization/kinematic_state"
ACCELERATION, ACCELERATION_TOPIC = "geometry_msgs/msg/AccelWithCovarianceStamped", "/localization/acceleration"
SIGNALS = "autoware_perception_msgs/msg/TrafficLightGroupArray"
SIGNALS_TOPIC = "/perception/traffic_light_recognition/traffic_signals"
KINDS = {1: Kind.CAR, **dict.fromkeys((2, 3, 4), Kind.TRUCK), 5: Kind.MOTORCYCLE, 6: Kind.BICYCLE, 7: Kind.PEDESTRIAN}
"""Kinds by the labels of ObjectClassification: car, truck, bus, trailer, motorcycle, bicycle, pedestrian."""
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


class SignalChange(NamedTuple):
    """A change of a traffic light: time from frame 0 [s], id of its Lanelet2 relation, name of what it shows."""

    begin: float
    group: str
    state: str


@dataclass(frozen=True)
class BagContent:
    """What a bag holds.

    Attributes:
        recording: all agents; note `ego` of its header is the id of the ego.
        signals: changes of the traffic lights, ascending.
    """

    recording: Recording
    signals: tuple[SignalChange, ...]


def read_bag(path: Path) -> BagContent:
    """Returns the traffic in a bag at 10 Hz, by the stamps of its messages; frame 0 is at the first.

    The ego's box is that of the file `vehicle_info.param.yaml` beside the bag, else of Autoware's sample vehicle.

    Raises:
        InputError: the bag cannot be read, or holds neither objects nor the ego, or not with usable values.
    """
    info = path.parent / VEHICLE_FILE
    vehicle = read_yaml(info, _VehicleFile).all_nodes.ros__parameters if info.is_file() else VehicleInfo()
    source = path.parent if path.name == METADATA_FILE else path
    try:
        with AnyReader([source], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            tracks, ego, shown = _Tracks(), _Ego(vehicle), dict[str, list[tuple[int, str]]]()
            for connection, message in _messages(reader, path):
                if connection.msgtype in OBJECTS:
                    tracks.take(message)
                elif connection.msgtype == SIGNALS:
                    _take_lights(shown, message)
                else:
                    ego.take(connection.topic, message)
    except (AnyReaderError, ReaderError, sqlite3.Error, OSError, *UNDECODABLE) as error:
        raise InputError(f"{path}: cannot be read as a bag: {' '.join(str(error).split())}") from error
    rows = [*tracks.rows, *ego.rows(tracks.free_id)]
    if not rows:
        raise InputError(f"{path}: no objects in {' or '.join(OBJECTS.values())}, and no ego in {POSE_TOPIC}")
    table = pd.DataFrame(rows, columns=_Row._fields)
    zero_ns = int(table["t"].min()) // STEP_NS * STEP_NS
    table, counts = _usable(table.assign(t=1e-9 * (table["t"] - zero_ns)), path), Counts()
    frames = resampled(split(table, counts), path, counts)
    notes: dict[str, object] = {"file": path.name} | {name: count for name, count in counts.note().items() if count}
    if ego.poses:  # the longest of its pieces, if its track has holes
        pieces = frames["vehicle_id"][(frames["vehicle_id"] - tracks.free_id) % PIECE == 0]
        notes |= {"ego": int(pieces.mode().iloc[0]), "ego_size": VEHICLE_FILE if info.is_file() else SAMPLE_VEHICLE}
    name = path.parent.name if path.name == METADATA_FILE else path.stem
    header = RecordingHeader(name=name, source="ROS 2 bag of Autoware", licence="unknown", notes=notes)
    recording = Recording.from_table(header, frames[list(COLUMNS)], f"{path}, brought to 10 Hz")
    signals = [
        SignalChange(round(1e-9 * (time - zero_ns), 3), group, state)
        for group, changes in shown.items()
        for time, state in changes
    ]
    return BagContent(recording, tuple(sorted(signals)))


class _Row(NamedTuple):
    """An agent at a time `t` [ns]: seconds since 1970 as floating-point numbers would be off by 0.1 us."""

    vehicle_id: int
    t: int
    x: float
    y: float
    yaw: float
    speed: float
    acceleration: float
    length: float
    width: float
    kind: int
    lane: int = -1


class _Tracks:
    """Collects the tracks of objects."""

    def __init__(self) -> None:
        self.rows: list[_Row] = []
        self._ids: dict[bytes, int] = {}

    @property
    def free_id(self) -> int:
        """An id that no object has."""
        return max(self._ids.values(), default=0) + 1

    def take(self, message: Any) -> None:
        """Takes a list of objects."""
        time = _ns(message.header.stamp)
        for tracked in message.objects:
            about = tracked.kinematics
            initial = "initial_" if hasattr(about, "initial_pose_with_covariance") else ""
            pose = getattr(about, f"{initial}pose_with_covariance").pose
            twist = getattr(about, f"{initial}twist_with_covariance").twist
            accel = getattr(about, f"{initial}acceleration_with_covariance").accel
            place, speed = pose.position, hypot(twist.linear.x, twist.linear.y)
            size = _size(tracked.shape)
            likely = max(tracked.classification, key=lambda label: label.probability, default=None)
            kind = Kind.UNKNOWN if likely is None else KINDS.get(int(likely.label), Kind.UNKNOWN)
            uuid = bytes(tracked.object_id.uuid)
            if uuid not in self._ids:
                agent = agent_of(uuid)
                self._ids[uuid] = self.free_id if agent is None else agent
            values = (place.x, place.y, _yaw(pose.orientation), speed, accel.linear.x, *size, int(kind))
            self.rows.append(_Row(self._ids[uuid], time, *values))


class _Ego:
    """Collects the motion of the ego."""

    def __init__(self, vehicle: VehicleInfo) -> None:
        self.poses: list[tuple[int, float, float, float, float]] = []  # t [ns], x, y of the box centre, yaw, speed
        self._accelerations: list[tuple[int, float]] = []
        self._vehicle = vehicle

    def take(self, topic: str, message: Any) -> None:
        """Takes a message about the ego, whose pose is that of its rear axle."""
        time = _ns(message.header.stamp)
        if topic == ACCELERATION_TOPIC:
            self._accelerations.append((time, message.accel.accel.linear.x))
            return
        place, yaw = message.pose.pose.position, _yaw(message.pose.pose.orientation)
        ahead = 0.5 * self._vehicle.length - self._vehicle.rear_overhang
        centre = place.x + ahead * np.cos(yaw), place.y + ahead * np.sin(yaw)
        twist = message.twist.twist.linear
        self.poses.append((time, *centre, yaw, hypot(twist.x, twist.y)))

    def rows(self, ego_id: int) -> Iterator[_Row]:
        """Yields the ego as a track."""
        if not self.poses:
            return
        time = np.array([pose[0] for pose in self.poses], np.int64)
        speed = np.array([pose[4] for pose in self.poses])
        if self._accelerations:
            stamps, felt = zip(*sorted(self._accelerations), strict=True)
            acceleration = np.interp(time - time[0], np.array(stamps, np.int64) - time[0], felt)
        else:
            order = np.argsort(time)
            acceleration = np.zeros(len(time))
            if len(time) > 1 and (np.diff(time[order]) > 0.0).all():
                acceleration[order] = np.gradient(speed[order], 1e-9 * (time[order] - time[0]))
        for pose, rate in zip(self.poses, acceleration.tolist(), strict=True):
            yield _Row(ego_id, *pose, rate, self._vehicle.length, self._vehicle.width, int(Kind.CAR))


def _take_lights(shown: dict[str, list[tuple[int, str]]], message: Any) -> None:
    """Adds the changes that a message tells to what each traffic light has `shown`, with the time [ns]."""
    for light in message.traffic_light_groups:
        state = _state(light.elements).name.lower()
        changes = shown.setdefault(str(light.traffic_light_group_id), [])
        if not changes or changes[-1][1] != state:
            changes.append((_ns(message.stamp), state))


def _messages(reader: AnyReader, path: Path) -> Iterator[tuple[Connection, Any]]:
    """Yields the messages on the topics that are read.

    Raises:
        InputError: of a type there is no definition, or there are several topics and none is the usual one.
    """
    listed = [kind for kind in OBJECTS if any(channel.msgtype == kind for channel in reader.connections)][:1]
    usual = {kind: OBJECTS[kind] for kind in listed} | {SIGNALS: SIGNALS_TOPIC, ODOMETRY: POSE_TOPIC}
    topics = {topic for kind, name in usual.items() if (topic := _topic(reader, kind, name, path))}
    chosen = [channel for channel in reader.connections if channel.topic in topics]
    chosen += [
        channel
        for channel in reader.connections
        if channel.topic == ACCELERATION_TOPIC and channel.msgtype == ACCELERATION
    ]
    for channel in chosen:
        if channel.msgtype not in reader.typestore.fielddefs:
            raise InputError(
                f"{path}: topic {channel.topic}: the bag has no definition of {channel.msgtype}, "
                "as bags before ROS 2 Iron; convert it with `ros2 bag convert` where Autoware is installed"
            )
    for connection, _, data in reader.messages(chosen):
        yield connection, reader.deserialize(data, connection.msgtype)


def _topic(reader: AnyReader, kind: str, usual: str, path: Path) -> str | None:
    """Returns the topic of a type: the usual one, else the only one, of odometry none; None without any."""
    names = sorted({connection.topic for connection in reader.connections if connection.msgtype == kind})
    if usual in names or kind == ODOMETRY:
        return usual if usual in names else None
    if len(names) < 2:
        return next(iter(names), None)
    raise InputError(f"{path}: {kind} on {', '.join(names)}, expected it on {usual}, or on one topic")


def _usable(table: pd.DataFrame, path: Path) -> pd.DataFrame:
    """Returns rows in order of vehicle and time, each time once, of one kind a track, and of sizes that vehicles have.

    Raises:
        InputError: a value is not finite.
    """
    numbers = table[["t", "x", "y", "yaw", "speed", "acceleration", "length", "width"]]
    if not (finite := np.isfinite(numbers.to_numpy()).all(axis=1)).all():
        first = table[~finite].iloc[0]
        raise InputError(
            f"{path}: vehicle {first['vehicle_id']} at {first['t']:.3f} s after the first message: "
            f"{', '.join(f'{name} {first[name]:g}' for name in numbers)}, expected finite numbers"
        )
    table = table.drop_duplicates(["vehicle_id", "t"]).sort_values(["vehicle_id", "t"], ignore_index=True)
    table["kind"] = table.groupby("vehicle_id")["kind"].transform(lambda kinds: kinds.mode().iloc[0])
    for name in ("length", "width"):
        table[name] = table[name].clip(*BOUNDS[name])
    return table


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


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _yaw(turn: Any) -> float:
    return atan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2))


def write_changes(changes: Sequence[SignalChange], path: Path) -> None:
    """Writes changes of signals as CSV, which a file of signals names in its field `states`.

    Raises:
        InputError: `path` cannot be written.
    """
    with replacing(path) as new:
        pd.DataFrame(changes, columns=SignalChange._fields).to_csv(new, index=False)
