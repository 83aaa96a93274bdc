"""Bags as Autoware's drives are recorded: a car, a pedestrian who comes at step 4, the ego, and two traffic lights."""

from collections.abc import Callable
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from litsim_sim.ego_port.object_ids import uuids_of

PACKAGE = "autoware_perception_msgs"
OBJECTS = {
    "TrackedObjects": "/perception/object_recognition/tracking/objects",
    "PredictedObjects": "/perception/object_recognition/objects",
}
POSE, LIGHTS = "/localization/kinematic_state", "/perception/traffic_light_recognition/traffic_signals"
ODOMETRY = "nav_msgs/msg/Odometry"
KINEMATICS = """geometry_msgs/PoseWithCovariance {0}pose_with_covariance
geometry_msgs/TwistWithCovariance {0}twist_with_covariance"""
OBJECT = """unique_identifier_msgs/UUID object_id
ObjectClassification[] classification
{0}Kinematics kinematics
Shape shape"""
LIST = "std_msgs/Header header\n{0}[] objects"
DEFINITIONS = {
    "ObjectClassification": "uint8 label\nfloat32 probability",
    "Shape": "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions",
    "TrackedObjectKinematics": KINEMATICS.format(""),
    "PredictedObjectKinematics": KINEMATICS.format("initial_"),
    "TrackedObject": OBJECT.format("TrackedObject"),
    "PredictedObject": OBJECT.format("PredictedObject"),
    "TrackedObjects": LIST.format("TrackedObject"),
    "PredictedObjects": LIST.format("PredictedObject"),
    "TrafficLightElement": "uint8 color\nuint8 shape\nuint8 status\nfloat32 confidence",
    "TrafficLightGroup": "int64 traffic_light_group_id\nTrafficLightElement[] elements",
    "TrafficLightGroupArray": "builtin_interfaces/Time stamp\nTrafficLightGroup[] traffic_light_groups",
}
"""Messages of Autoware, without the fields that nobody reads."""
BEGIN_NS = 1_700_000_000 * 10**9
CAR, WALKER, EGO = 12, 43, 44
TRACKS = {
    CAR: (20.0, -5.0, 0.0, 8.0, (4.5, 1.9), 1),
    WALKER: (3.0, 7.0, np.pi / 2, 1.0, (0.6, 0.6), 7),
    EGO: (0.0, 1.0, 0.2, 5.0, (4.8, 1.8), 0),
}
"""x, y at step 0 [m], heading [rad], speed [m/s], size [m], label; of the ego the middle of its rear axle."""
REAR_TO_CENTRE = 1.6  # [m]
INFO = """/**:
  ros__parameters: {wheel_radius: 0.4, wheel_base: 3.0, wheel_tread: 1.6, front_overhang: 1.0, rear_overhang: 0.8,
    left_overhang: 0.1, right_overhang: 0.1, vehicle_height: 2.0}
"""
"""The ego's size in Autoware's file."""


class Messages:
    """Messages of one version of Autoware, by the `package` that has its lists of objects."""

    def __init__(self, package: str) -> None:
        self.package, self.store = package, get_typestore(Stores.ROS2_JAZZY)
        for name, text in DEFINITIONS.items():
            self.store.register(get_types_from_msg(text, f"{package}/msg/{name}"))

    def make(self, name: str, **fields: Any) -> Any:
        """Returns a message; fields that are not given are 0 or empty."""
        full = name if "/" in name else f"{self.package}/msg/{name}"
        empty = {field: self._empty(*kind) for field, kind in self.store.fielddefs[full][1]}
        return self.store.types[full](**(empty | fields))

    def _empty(self, form: int, what: Any) -> Any:
        if form == 2:  # a message
            return self.make(what)
        if form == 1:
            return "" if what[0] == "string" else 0
        if form == 3:
            return np.zeros(what[1], what[0][1][0])
        return [] if what[0][0] == 2 or what[0][1][0] == "string" else np.zeros(0, what[0][1][0])

    def header(self, time_ns: int) -> Any:
        """Returns a header in frame map."""
        sec, nanosec = divmod(time_ns, 10**9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="map")

    def pose(self, x: float, y: float, yaw: float, speed: float, initial: str = "") -> dict[str, Any]:
        """Returns the fields of pose and twist."""
        geometry = "geometry_msgs/msg/"
        place = self.make(f"{geometry}Point", x=x, y=y)
        turn = self.make(f"{geometry}Quaternion", z=sin(0.5 * yaw), w=cos(0.5 * yaw))
        pose = self.make(f"{geometry}Pose", position=place, orientation=turn)
        twist = self.make(f"{geometry}Twist", linear=self.make(f"{geometry}Vector3", x=speed))
        return {
            f"{initial}pose_with_covariance": self.make(f"{geometry}PoseWithCovariance", pose=pose),
            f"{initial}twist_with_covariance": self.make(f"{geometry}TwistWithCovariance", twist=twist),
        }

    def object(self, kind: str, agent: int, seconds: float) -> Any:
        """Returns an agent in a list of `kind`, so many seconds after step 0."""
        *_, size, label = TRACKS[agent]
        initial = "initial_" if kind == "PredictedObjects" else ""
        dimensions = self.make("geometry_msgs/msg/Vector3", x=size[0], y=size[1])
        kinematics = self.make(f"{kind[:-1]}Kinematics", **self.pose(*motion(agent, seconds), initial))
        return self.make(
            kind[:-1],
            object_id=self.make("unique_identifier_msgs/msg/UUID", uuid=uuids_of(np.array([agent]))[0]),
            classification=[self.make("ObjectClassification", label=label, probability=1.0)],
            kinematics=kinematics,
            shape=self.make("Shape", dimensions=dimensions),
        )

    def lights(self, step: int, stamp: Any) -> Any:
        """Returns what lights show: 7023 turns green at step 10, after red and amber; 9 flashes amber."""
        shown = [(1, 2), (2, 2)] if step in (8, 9) else [(1 if step < 8 else 3, 2)]
        groups = []
        for group, elements in ((7023, shown), (9, [(2, 3)])):
            lit = [self.make("TrafficLightElement", color=c, status=s, shape=1) for c, s in elements]
            groups.append(self.make("TrafficLightGroup", traffic_light_group_id=group, elements=lit))
        return self.make("TrafficLightGroupArray", stamp=stamp, traffic_light_groups=groups)


def motion(agent: int, seconds: float) -> tuple[float, float, float, float]:
    """Returns x, y [m], heading [rad] and speed [m/s] of an agent."""
    x, y, yaw, speed, *_ = TRACKS[agent]
    return x + speed * seconds * cos(yaw), y + speed * seconds * sin(yaw), yaw, speed


def write(
    folder: Path,
    kind: str = "TrackedObjects",
    change: Callable[[Any, int], None] = lambda *_: None,
    *,
    package: str = PACKAGE,
    plugin: StoragePlugin = StoragePlugin.MCAP,
    period: float = 0.1,
    steps: int = 31,
    pose: str = POSE,
) -> Path:
    """Writes a bag; `change` is done to each list of objects, at its step."""
    messages = Messages(package)
    topics = {pose: ODOMETRY, OBJECTS[kind]: f"{package}/msg/{kind}", LIGHTS: f"{package}/msg/TrafficLightGroupArray"}
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=messages.store) for topic, name in topics.items()
        }
        for step in range(steps):
            seconds = period * step
            time_ns = BEGIN_NS + round(1e9 * seconds)
            ego = messages.pose(*motion(EGO, seconds))
            agents = [messages.object(kind, agent, seconds) for agent in (CAR, WALKER)[: 2 if step >= 4 else 1]]
            listed = messages.make(kind, header=messages.header(time_ns), objects=agents)
            change(listed, step)
            moved = {name.removesuffix("_with_covariance"): value for name, value in ego.items()}
            content = {
                pose: messages.make(ODOMETRY, header=messages.header(time_ns), **moved),
                OBJECTS[kind]: listed,
                LIGHTS: messages.lights(step, messages.header(time_ns).stamp),
            }
            for topic, message in content.items():
                writer.write(connections[topic], time_ns, messages.store.serialize_cdr(message, topics[topic]))
    (folder / "vehicle_info.param.yaml").write_text(INFO)
    return folder / "metadata.yaml"
