"""Arrays to messages and back through CDR, bit for bit; definitions and hashes as other readers know them."""

import struct
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from litsim_msgs.msg import AgentStates, Controls, EgoControl, StageStatus
from mcap_ros2._dynamic import generate_dynamic
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from litsim_sim.core.scene import (
    ARRAY_FIELDS,
    DTYPES,
    AgentTable,
    Controller,
    ControlSource,
    ControlTable,
    EgoCommand,
    EgoMode,
    Kind,
)
from litsim_sim.ros import definitions, messages, topics

MESSAGES = Path(__file__).resolve().parents[3] / "src/litsim_msgs/msg"
OURS = sorted(f"litsim_msgs/msg/{path.stem}" for path in MESSAGES.glob("*.msg"))
RECORDED = sorted({definitions.type_name(topic.type) for topic in topics.RECORDED_TOPICS})

steps = st.integers(0, 2**31 - 1)
floats = st.floats(allow_nan=True, allow_infinity=True)


def through_cdr(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def table_of(count: int, values: list[float], step: int = 0) -> AgentTable:
    """Agents whose float columns run through `values`."""
    pool = np.resize(np.array(values, np.float64), 8 * count).reshape(8, count)
    whole = np.arange(count)
    return AgentTable(
        step, 3 * whole - 2, (255 - whole).astype(np.uint8), (whole % 4).astype(np.uint8), *(v.copy() for v in pool)
    )


# Arrays


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64, np.uint8])
def test_arrays_of_any_shape_come_back_flat_and_writable(dtype: type[np.generic]) -> None:
    values = np.arange(24).astype(dtype).reshape(2, 3, 4)
    back = np.array(messages.to_array(values), dtype)
    assert same_bits(back, values.ravel())
    back[0] = 1
    strided = values[:, ::2, 1:3]
    assert same_bits(np.array(messages.to_array(strided), dtype), strided.ravel())
    transposed = values.T
    assert same_bits(np.array(messages.to_array(transposed), dtype), transposed.ravel())


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64, np.uint8])
def test_empty_arrays_come_back_empty(dtype: type[np.generic]) -> None:
    back = np.array(messages.to_array(np.empty((0, 3), dtype)), dtype)
    assert (back.shape, back.dtype) == ((0,), dtype)


# Time


@given(steps)
def test_stamps_are_whole_tenths_of_a_second(step: int) -> None:
    stamp = messages.stamp(step)
    assert stamp.sec * 10**9 + stamp.nanosec == step * 10**8
    assert 0 <= stamp.nanosec < 10**9


def test_headers_are_in_frame_map() -> None:
    header = messages.header(123)
    assert (header.frame_id, header.stamp) == ("map", Time(sec=12, nanosec=300_000_000))


# Agents, controls, ego


@given(st.integers(0, 30), st.lists(floats, min_size=1, max_size=40), steps)
def test_agent_tables_come_back_bit_for_bit(count: int, values: list[float], step: int) -> None:
    table = table_of(count, values, step)
    message = through_cdr(messages.agents_to_message(table, "run-1", 280, -7))
    assert (message.run_id, message.step, message.total_steps, message.ego_id) == ("run-1", step, 280, -7)
    assert message.header == messages.header(step)
    back = AgentTable.of_message(message)
    assert back.step == step
    for field in ARRAY_FIELDS:
        assert getattr(back, field).dtype == DTYPES[field]
        assert same_bits(getattr(back, field), getattr(table, field)), field


def test_every_column_goes_into_the_field_of_its_name() -> None:
    table = AgentTable(4, *(np.array([i], DTYPES[f]) for i, f in enumerate(ARRAY_FIELDS)))
    message = messages.agents_to_message(table, "run-1", 280, 1)
    for i, field in enumerate(ARRAY_FIELDS):
        assert list(getattr(message, field)) == [i], field


def test_tables_from_messages_can_be_changed() -> None:
    message = messages.agents_to_message(table_of(2, [1.0]), "run-1", 1, 1)
    AgentTable.of_message(message).x[0] = 5.0
    assert list(message.x) == [1.0, 1.0]


@given(st.integers(0, 20), st.lists(floats, min_size=1, max_size=30), steps)
def test_controls_come_back_bit_for_bit(count: int, values: list[float], step: int) -> None:
    pool = np.resize(np.array(values), 3 * count).reshape(3, count)
    source = (1 + np.arange(count) % 3).astype(np.uint8)
    controls = ControlTable(step, np.arange(count) * 2**40, *(v.copy() for v in pool), source)
    message = through_cdr(messages.controls_to_message(controls, "run-1"))
    assert (message.run_id, message.step, message.header) == ("run-1", step, messages.header(step))
    back = ControlTable.of_message(message)
    for field in fields(ControlTable):
        assert same_bits(np.asarray(getattr(back, field.name)), np.asarray(getattr(controls, field.name))), field.name


@given(steps, floats, floats, st.sampled_from(EgoMode))
def test_ego_commands_come_back_bit_for_bit(step: int, acceleration: float, yaw_rate: float, mode: EgoMode) -> None:
    message = through_cdr(messages.ego_to_message(EgoCommand(step, acceleration, yaw_rate, mode), "run-1"))
    assert (message.run_id, message.header) == ("run-1", messages.header(step))
    back = EgoCommand.of_message(message)
    assert (back.step, back.mode) == (step, mode)
    assert struct.pack("dd", back.acceleration, back.yaw_rate) == struct.pack("dd", acceleration, yaw_rate)


def test_an_ego_command_of_unknown_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="mode is 7, expected 0"):
        EgoCommand.of_message(EgoControl(mode=7))


def test_numpy_scalars_make_an_ego_command() -> None:
    command = EgoCommand(3, np.float64(0.5), np.float32(0.25))
    assert EgoCommand.of_message(messages.ego_to_message(command, "run-1")) == EgoCommand(3, 0.5, 0.25)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(Controller, AgentStates), (Kind, AgentStates), (ControlSource, Controls), (EgoMode, EgoControl)],
)
def test_enums_are_numbered_as_in_the_messages(ours: Any, theirs: Any) -> None:
    for member in ours:
        assert getattr(theirs, member.name) == member.value


def test_status() -> None:
    message = through_cdr(messages.status("run-1", "policy", StageStatus.FAILED, 12, 0.25, "why"))
    assert (message.run_id, message.stage, message.state, message.step) == ("run-1", "policy", StageStatus.FAILED, 12)
    assert (message.compute_time, message.text, message.header) == (0.25, "why", messages.header(12))


# Standard messages


def yaw_of(orientation: Any) -> float:
    assert (orientation.x, orientation.y) == (0.0, 0.0)
    return 2.0 * float(np.arctan2(orientation.z, orientation.w))


@given(st.floats(-3.1, 3.1), st.floats(0, 40), st.floats(-1, 1))
def test_odometry_of_the_ego(agent_table: Callable[..., AgentTable], yaw: float, speed: float, rate: float) -> None:
    ego = {"id": 5, "x": 10.0, "y": -3.0, "length": 4.0, "yaw": yaw, "speed": speed, "yaw_rate": rate}
    message = through_cdr(messages.ego_odometry(agent_table(8, {"id": 1}, ego), 5, 0.25))
    pose, twist = message.pose.pose, message.twist.twist
    assert (message.header, message.child_frame_id) == (messages.header(8), "ego")
    assert (pose.position.x, pose.position.y, pose.position.z) == (10.0, -3.0, 0.0)
    assert yaw_of(pose.orientation) == pytest.approx(yaw, abs=1e-12)
    assert (twist.linear.x, twist.angular.z) == (speed, rate)
    assert twist.linear.y == pytest.approx(rate)  # of the centre, a metre ahead of the axle


def test_odometry_once_the_ego_has_left(agent_table: Callable[..., AgentTable]) -> None:
    message = messages.ego_odometry(agent_table(8, {"id": 1, "x": 9.0}), 5, 0.29)
    assert message.header == messages.header(8)
    assert (message.pose.pose.position.x, message.twist.twist.linear.x) == (0.0, 0.0)


def test_poses_of_a_route_look_at_the_next() -> None:
    points = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 5.0], [5.0, 10.0]])
    message = through_cdr(messages.route_path(points, 2))
    assert message.header == messages.header(2)
    assert [(p.pose.position.x, p.pose.position.y) for p in message.poses] == [tuple(p) for p in points.tolist()]
    yaws = [yaw_of(p.pose.orientation) for p in message.poses]
    assert yaws == pytest.approx([0.0, np.pi / 2, 3 * np.pi / 4, 3 * np.pi / 4])


# Definitions and hashes


def test_a_definition_is_its_own_text_and_that_of_all_types_in_it_once() -> None:
    text = definitions.definition("nav_msgs/msg/Odometry")
    own, *others = text.split("\n" + "=" * 80 + "\n")
    assert "geometry_msgs/PoseWithCovariance pose" in own
    names = [other.splitlines()[0].removeprefix("MSG: ") for other in others]
    assert len(names) == len(set(names))
    assert set(names) == {
        *("std_msgs/Header", "builtin_interfaces/Time"),
        *("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion"),
        *("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist", "geometry_msgs/Vector3"),
    }


@pytest.mark.parametrize("name", sorted({*RECORDED, *OURS}))
def test_definitions_are_complete_for_other_readers(name: str) -> None:
    found = get_types_from_msg(definitions.definition(name), name)
    store = get_typestore(Stores.EMPTY)
    store.register(found)
    assert store.generate_msgdef(name, ros_version=2)[0]  # fails where a type in it is unknown
    assert generate_dynamic(name, definitions.definition(name))


def test_readers_without_ros_decode_by_the_definition(agent_table: Callable[..., AgentTable]) -> None:
    table = agent_table(8, {"id": 1, "x": 1.5}, {"id": 5, "x": -2.5, "yaw": 0.5, "speed": 12.0})
    agents = messages.agents_to_message(table, "run-1", 280, 5)
    odometry = messages.ego_odometry(table, 5, 0.29)
    for name, message in (("litsim_msgs/msg/AgentStates", agents), ("nav_msgs/msg/Odometry", odometry)):
        text, data = definitions.definition(name), serialize_message(message)
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(text, name))
        decoded = [store.deserialize_cdr(data, name), generate_dynamic(name, text)[name](data)]
        for each in decoded:
            assert (each.header.stamp.nanosec, each.header.frame_id) == (800_000_000, "map")
            if message is agents:
                assert (each.run_id, list(each.id), list(each.x)) == ("run-1", [1, 5], [1.5, -2.5])
            else:
                assert (each.pose.pose.position.x, each.twist.twist.linear.x) == (-2.5, 12.0)


@pytest.mark.parametrize("name", sorted({*RECORDED, *OURS}))
def test_type_hashes_are_those_that_the_definition_gives(name: str) -> None:
    """REP 2016 hashes do not depend on who computes them: rosidl's against those of rosbags."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definitions.definition(name), name))
    found = definitions.type_hash(name)
    assert found.startswith("RIHS01_")
    assert found == store.hash_rihs01(name)


def test_the_hash_of_a_type_without_a_description_is_empty() -> None:
    assert definitions.type_hash("litsim_msgs/msg/NoSuchMessage") == ""


def test_definitions_are_those_of_the_source_tree() -> None:
    for name in OURS:
        assert definitions.definition(name).startswith((MESSAGES / f"{name.split('/')[-1]}.msg").read_text())
