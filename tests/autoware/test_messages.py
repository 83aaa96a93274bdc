"""Messages written as arrays are what rclpy writes of the message objects, byte by byte."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("autoware_perception_msgs", reason="Autoware's messages are not built (tools/interfaces.sh)")

from autoware_perception_msgs.msg import (
    ObjectClassification,
    PredictedObject,
    PredictedObjects,
    TrackedObject,
    TrackedObjects,
    TrafficLightElement,
    TrafficLightGroup,
    TrafficLightGroupArray,
)
from autoware_vehicle_msgs.msg import GearReport, SteeringReport, VelocityReport
from geometry_msgs.msg import AccelWithCovarianceStamped
from litsim_msgs.msg import RunInfo
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message

from litsim_autoware.messages import objects, vehicle
from litsim_autoware.messages.objects import Forecast
from litsim_autoware.messages.vehicle import RearAxle
from litsim_autoware.node.announced_run import AnnouncedRun
from litsim_sim.core.scene import ARRAY_FIELDS, AgentTable
from litsim_sim.ros.cdr import without_padding

STAMP_NS = 12_300_000_000


@pytest.mark.parametrize("agents", [0, 1, 7])
@pytest.mark.parametrize(
    ("write", "kind"), [(objects.predicted_objects, PredictedObjects), (objects.tracked_objects, TrackedObjects)]
)
def test_objects(write: Any, kind: Any, agents: int) -> None:
    table = made_table(agents)
    message = read(write(table, STAMP_NS), kind)
    assert (message.header.stamp.sec, message.header.frame_id, len(message.objects)) == (12, "map", agents)
    for row, (found, kind_of) in enumerate(zip(message.objects, table.kind, strict=True)):
        pose, twist, accel, path = parts_of(found)
        assert (pose.position.x, pose.position.y) == (table.x[row], table.y[row])
        assert 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(table.yaw[row])
        assert (twist.linear.x, twist.angular.z) == (table.speed[row], table.yaw_rate[row])
        assert (found.shape.dimensions.x, found.shape.dimensions.y) == (table.length[row], table.width[row])
        assert pose.position.z == 0.5 * found.shape.dimensions.z
        labels = ObjectClassification
        wanted = {0: labels.CAR, 1: labels.TRUCK, 2: labels.MOTORCYCLE, 3: labels.BICYCLE, 4: labels.PEDESTRIAN}
        assert [each.label for each in found.classification] == [wanted.get(int(kind_of), labels.UNKNOWN)]
        assert accel.linear.x == table.acceleration[row]
        assert int.from_bytes(bytes(found.object_id.uuid[8:]), "little") == table.id[row]
        if path is not None:
            assert (len(path.path), path.time_step.nanosec, path.confidence) == (11, 500_000_000, 1.0)
            away = np.hypot(path.path[-1].position.x - table.x[row], path.path[-1].position.y - table.y[row])
            assert away == pytest.approx(5.0 * table.speed[row])


def test_objects_are_what_the_ego_is_told(make_scenario, track) -> None:
    hide = {"kind": "hide", "agent": 2, "begin_s": 1.0, "duration_s": 0.5}
    tracks = (track(1, x=100.0), track(2, x=140.0), track(3, x=170.0))
    scenario = make_scenario(*tracks, changes=[hide, {"kind": "noise", "sigma_m": 0.5}])
    run = AnnouncedRun.of(RunInfo(scenario_yaml=scenario.to_yaml(), ego_id=1))
    perceived = [run.others(scenario.log.table(step)) for step in (9, 10, 14, 15)]
    assert [table.id.tolist() for table in perceived] == [[2, 3], [3], [3], [2, 3]]
    errors = [table.x[-1] - scenario.log.table(table.step).x[2] for table in perceived]
    assert all(0.0 < abs(error) < 3.0 for error in errors)


def parts_of(found: Any) -> tuple[Any, Any, Any, Any]:
    """Pose, twist, acceleration and predicted path of an object; None for the path of one that is tracked."""
    about = found.kinematics
    if isinstance(found, PredictedObject):
        accel = about.initial_acceleration_with_covariance.accel
        pose, twist = about.initial_pose_with_covariance.pose, about.initial_twist_with_covariance.twist
        return pose, twist, accel, about.predicted_paths[0]
    assert isinstance(found, TrackedObject)
    accel = about.acceleration_with_covariance.accel
    return about.pose_with_covariance.pose, about.twist_with_covariance.twist, accel, None


def test_paths_are_those_of_the_forecast_of_the_step_before() -> None:
    table = made_table(3)
    k = np.arange(1, 26)
    mean = np.stack(np.broadcast_arrays(20.0 * k, 2.0), axis=-1)[None].repeat(2, axis=0)  # 20 m in each 0.2 s
    ids, valid = np.array([table.id[0], table.id[2]]), np.array([True, False])
    forecast = Forecast(table.step - 1, 0.2, ids, mean, np.full((2, 25), 0.5), np.array([0.75, 1.0]), valid)
    first, second, third = read(objects.predicted_objects(table, STAMP_NS, forecast), PredictedObjects).objects
    (path,) = first.kinematics.predicted_paths
    assert path.confidence == 0.75
    assert [pose.position.x for pose in path.path[1:]] == pytest.approx([10.0 * (5 * n + 1) for n in range(1, 11)])
    assert (path.path[0].position.x, path.path[3].position.y) == (table.x[0], 2.0)
    assert 2.0 * np.arcsin(path.path[1].orientation.z) == pytest.approx(0.5)
    for row, other in ((1, second), (2, third)):  # without a forecast, and without a valid one
        (path,) = other.kinematics.predicted_paths
        away = np.hypot(path.path[-1].position.x - table.x[row], path.path[-1].position.y - table.y[row])
        assert (path.confidence, away) == (1.0, pytest.approx(5.0 * table.speed[row]))


@pytest.mark.parametrize("groups", [0, 3])
def test_traffic_lights(groups: int) -> None:
    states = np.array([3, 6, 8][:groups], np.uint8)
    data = objects.traffic_lights(np.arange(groups) + 100, states, STAMP_NS)
    message = read(data, TrafficLightGroupArray)
    element = TrafficLightElement
    colours = [element.RED, element.GREEN, element.AMBER][:groups]
    found = [(each.traffic_light_group_id, each.elements[0].color) for each in message.traffic_light_groups]
    assert found == [(100 + row, colour) for row, colour in enumerate(colours)]
    assert all(each.elements[0].status == element.SOLID_ON for each in message.traffic_light_groups)
    assert all(isinstance(each, TrafficLightGroup) for each in message.traffic_light_groups)


def test_the_ego() -> None:
    motion = RearAxle(1.0, 2.0, 0.5, 10.0, -1.5, 0.1)
    odometry = read(motion.odometry(STAMP_NS), Odometry)
    assert (odometry.header.frame_id, odometry.child_frame_id, odometry.pose.pose.position.y) == (
        "map",
        "base_link",
        2.0,
    )
    assert (odometry.twist.twist.linear.x, odometry.twist.twist.angular.z) == (10.0, 0.1)
    accel = read(motion.accel(STAMP_NS), AccelWithCovarianceStamped)
    assert (accel.header.frame_id, accel.accel.accel.linear.x) == ("base_link", -1.5)
    velocity = read(motion.velocity(STAMP_NS), VelocityReport)
    assert (velocity.longitudinal_velocity, velocity.heading_rate) == (10.0, np.float32(0.1))
    assert read(vehicle.report(22, STAMP_NS), GearReport).report == 22
    assert read(vehicle.steering_report(0.25, STAMP_NS), SteeringReport).steering_tire_angle == 0.25


def test_the_frame_of_the_ego() -> None:
    kind = pytest.importorskip("tf2_msgs.msg").TFMessage
    (transform,) = read(RearAxle(1.0, 2.0, 0.5, 10.0, 0.0, 0.0).transform(STAMP_NS), kind).transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
    assert (transform.transform.translation.x, transform.transform.rotation.z) == (1.0, np.sin(0.25))


def made_table(agents: int) -> AgentTable:
    """Agents of all kinds with different values in every column."""
    rng = np.random.default_rng(agents)
    columns = {name: rng.uniform(1.0, 5.0, agents) for name in ARRAY_FIELDS}
    kinds = np.array([0, 1, 2, 3, 4, 255, 0][:agents], np.uint8)
    whole = {"id": np.arange(agents) + 5, "kind": kinds, "controller": np.zeros(agents, np.uint8)}
    return AgentTable(3, **(columns | {"yaw": rng.uniform(-3.0, 3.0, agents)} | whole))


def read(data: bytes, kind: Any) -> Any:
    """The message object, which rclpy would have written as the same bytes, but for what lies in the padding."""
    message = deserialize_message(data, kind)
    clear = without_padding(kind)
    assert clear(serialize_message(message)) == clear(data)
    return message
