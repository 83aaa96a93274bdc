"""The record of a run with its scene in standard messages, as viewers draw it: frames, boxes, a cloud, lights."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from contextlib import closing
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from litsim_data.exports.export import Content, Export
from litsim_sim.core.colours import LIGHTS, colour_of
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_NS, Controller, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.core.topic_names import LIGHT_MARKERS, MARKERS_AGENTS, OBJECTS, TF, TF_STATIC
from litsim_sim.core.vehicle import HEIGHTS, VehicleModel
from litsim_sim.io.files import replacing
from litsim_sim.io.yaml_input import load_yaml
from litsim_sim.lane_map.signal_links import stop_line_parts
from litsim_sim.record.bag import BagReader, qos_yaml
from litsim_sim.record.clouds import fields_of, object_points
from litsim_sim.record.run import SCENARIO_FILE

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = {
    TF_STATIC: "tf2_msgs/msg/TFMessage",
    TF: "tf2_msgs/msg/TFMessage",
    OBJECTS: "sensor_msgs/msg/PointCloud2",
    MARKERS_AGENTS: "visualization_msgs/msg/MarkerArray",
    LIGHT_MARKERS: "visualization_msgs/msg/MarkerArray",
}
"""The topics of the scene, as the live graph and `live` have them."""
LINE_STRIP, CUBE, DELETE_ALL = 4, 1, 3  # of visualization_msgs/Marker
GREY = "#808080"


class Scene(Export):
    """A copy of the record, with the messages that a run does not record, as nobody needs them to judge."""

    endings, content = (".mcap",), "the record of a run with its scene for viewers: /tf, boxes, objects, lights"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`.export.Export`."""
        table = content.motion()
        if "controller" not in table:
            raise InputError(f"{content.path}: expected a run: the scene is added to its record")
        reader, count = BagReader(content.path), 0
        added = {topic: kind for topic, kind in TYPES.items() if topic not in reader.topics}
        vehicle = load_yaml(reader.attachments.get(SCENARIO_FILE, b"").decode(), str(content.path)) or {}
        rear_axle = VehicleModel.of(vehicle.get("vehicle", {})).rear_axle
        with replacing(out) as new, new.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="ros2", library="litsim")
            channels = {}
            for name, kind in added.items():
                definition, hashed = STORE.generate_msgdef(kind, ros_version=2)[0], STORE.hash_rihs01(kind)
                durability = "transient_local" if name == TF_STATIC else "volatile"
                channels[name] = _channel(writer, name, kind, definition, qos_yaml(10, durability=durability), hashed)
            for topic in reader.topics.values():
                described = topic.definition, topic.qos_yaml, topic.type_hash
                channels[topic.name] = _channel(writer, topic.name, topic.type_name, *described)
            for name, data in reader.attachments.items():
                writer.add_attachment(0, 0, name, "", data)
            writer.add_metadata("run", reader.metadata)
            ours = (message for message in _messages(content, table, rear_axle) if message[1] in added)
            recorded = ((message.log_time_ns, message.topic, message.data) for message in reader.messages())
            merged = heapq.merge(ours, recorded, key=itemgetter(0))  # ours before those of the same time
            for time, name, data in merged:
                writer.add_message(channels[name], time, data, time)
                count += name in added
            with closing(stream):
                writer.finish()
        return [f"{count} messages on {', '.join(added)}, beside those of the record"]


def _channel(writer: Writer, name: str, kind: str, definition: str, qos: str, hashed: str) -> int:
    schema = writer.register_schema(kind, "ros2msg", definition.encode())
    return writer.register_channel(name, "cdr", schema, {"offered_qos_profiles": qos, "topic_type_hash": hashed})


def _messages(content: Content, table: pd.DataFrame, rear_axle: float) -> Iterator[tuple[int, str, bytes]]:
    """Yields the messages of a scene in order of time: log time [ns], topic, CDR."""
    first = int(table["frame"].min())
    yield 0, TF_STATIC, _tf(0, "map", "odom", 0.0, 0.0, 0.0)
    every: Iterator[Any] = table.itertuples(index=False)
    for frame, rows in groupby(every, key=attrgetter("frame")):
        step, agents = int(frame) - first, [*rows]
        time, others = step * STEP_NS, [agent for agent in agents if agent.vehicle_id != content.ego]
        for ego in agents:
            if ego.vehicle_id == content.ego:
                back = rear_axle * ego.length
                x, y = ego.x - back * np.cos(ego.yaw), ego.y - back * np.sin(ego.yaw)
                yield time, TF, _tf(step, "odom", "base_link", x, y, ego.yaw)
        yield time, MARKERS_AGENTS, _markers(step, [_box(step, number, agent) for number, agent in enumerate(agents)])
        yield time, OBJECTS, _cloud(step, others)
        if content.signals is not None:
            yield time, LIGHT_MARKERS, _markers(step, _lights(step, content))


def _cdr(topic: str, message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, TYPES[topic]))


def _make(kind: str, *values: Any) -> Any:
    """Returns a message of a type by its fields in order."""
    return STORE.types[kind](*values)


def _header(step: int, frame: str = "map") -> Any:
    seconds, nanoseconds = divmod(step * STEP_NS, 10**9)
    return _make("std_msgs/msg/Header", _make("builtin_interfaces/msg/Time", seconds, nanoseconds), frame)


def _turn(yaw: float) -> Any:
    return _make("geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(0.5 * yaw)), float(np.cos(0.5 * yaw)))


def _tf(step: int, parent: str, child: str, x: float, y: float, yaw: float) -> bytes:
    place = _make("geometry_msgs/msg/Vector3", float(x), float(y), 0.0)
    moved = _make("geometry_msgs/msg/Transform", place, _turn(yaw))
    frame = _make("geometry_msgs/msg/TransformStamped", _header(step, parent), child, moved)
    return _cdr(TF, _make(TYPES[TF], [frame]))


def _colour(text: str) -> Any:
    return _make("std_msgs/msg/ColorRGBA", *(int(text[i : i + 2], 16) / 255.0 for i in (1, 3, 5)), 1.0)


def _marker(step: int, namespace: str, number: int, kind: int, **fields: Any) -> Any:
    point, origin = "geometry_msgs/msg/Point", (0.0, 0.0, 0.0)
    values: dict[str, Any] = {
        "pose": _make("geometry_msgs/msg/Pose", _make(point, *origin), _turn(0.0)),
        "scale": _make("geometry_msgs/msg/Vector3", *origin),
        "color": _colour(GREY),
        "points": [],
        "text": "",
        "action": 0,
    } | fields
    picture = _make("sensor_msgs/msg/CompressedImage", _header(0, ""), "", np.empty(0, np.uint8))
    mesh = _make("visualization_msgs/msg/MeshFile", "", np.empty(0, np.uint8))
    forever = _make("builtin_interfaces/msg/Duration", 0, 0)
    values |= {"header": _header(step), "ns": namespace, "id": number, "type": kind, "lifetime": forever}
    values |= {"texture_resource": "", "texture": picture, "uv_coordinates": [], "colors": [], "frame_locked": False}
    values |= {"mesh_resource": "", "mesh_file": mesh, "mesh_use_embedded_materials": False}
    return STORE.types["visualization_msgs/msg/Marker"](**values)


def _markers(step: int, markers: list[Any]) -> bytes:
    """Returns an array that replaces all markers of its topic, so that a viewer may begin anywhere."""
    fresh = _marker(step, "", 0, CUBE, action=DELETE_ALL)
    return _cdr(MARKERS_AGENTS, _make(TYPES[MARKERS_AGENTS], [fresh, *markers]))


def _box(step: int, number: int, agent: Any) -> Any:
    height = HEIGHTS[Kind(agent.kind)]
    place = _make("geometry_msgs/msg/Point", float(agent.x), float(agent.y), 0.5 * height)
    return _marker(
        *(step, "agents", number, CUBE),
        pose=_make("geometry_msgs/msg/Pose", place, _turn(float(agent.yaw))),
        scale=_make("geometry_msgs/msg/Vector3", float(agent.length), float(agent.width), height),
        color=_colour(colour_of(Controller[str(agent.controller).upper()])),
        text=f"{agent.vehicle_id}",
    )


def _cloud(step: int, agents: list[Any]) -> bytes:
    """Returns the agents as points of /litsim/objects."""

    def column(name: str) -> np.ndarray:
        return np.array([getattr(agent, "vehicle_id" if name == "id" else name) for agent in agents])

    points = object_points(column, len(agents))
    layout = points.dtype
    fields = [_make("sensor_msgs/msg/PointField", name, offset, kind, 1) for name, offset, kind in fields_of(layout)]
    described = {"header": _header(step), "height": 1, "width": len(agents), "fields": fields, "is_bigendian": False}
    size, data = layout.itemsize, np.frombuffer(points.tobytes(), np.uint8)
    row = {"point_step": size, "row_step": size * len(agents), "data": data, "is_dense": True}
    return _cdr(OBJECTS, STORE.types[TYPES[OBJECTS]](**described, **row))


def _lights(step: int, content: Content) -> list[Any]:
    assert content.signals is not None
    links, states = content.signals.links, content.signals.of_links(step)[0].tolist()
    return [
        _marker(
            *(step, "stop_lines", row, LINE_STRIP),
            scale=_make("geometry_msgs/msg/Vector3", 0.4, 0.0, 0.0),
            color=_make("std_msgs/msg/ColorRGBA", *LIGHTS[SignalState(state)], 1.0),
            points=[_make("geometry_msgs/msg/Point", float(x), float(y), 0.0) for x, y in line],
            text=f"{link.name} {SignalState(state).name}",
        )
        for row, (link, state, line) in enumerate(zip(links, states, stop_line_parts(links).tolist(), strict=True))
    ]
