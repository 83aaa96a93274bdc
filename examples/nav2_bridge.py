"""Lets nav2 drive, or any stack for mobile robots: odometry, frames, goal and a scan of the boxes out, a twist in.

    ./litsim launch --ego external --mode realtime --set bridge.clock=false -- python3 examples/nav2_bridge.py
    ros2 launch YOUR_NAV2.launch.py use_sim_time:=false     # in the same domain

The run is in real time, so that nav2 lives on the wall clock, which runs before the run as well. The bridge then leaves
/clock and /tf to this script: map -> odom -> base_link. The newest /cmd_vel answers each step; none is a standstill.
Other agents are in the scan of 720 rays from base_link. The costmaps get the ego's footprint, and nav2's navigator the
goal of the mission, on /goal_pose. Needs tf2_msgs.
"""

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Polygon, PolygonStamped, PoseStamped, TransformStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan, PointCloud2
from tf2_msgs.msg import TFMessage

RAYS, REACH = 720, 80.0  # [m]
ANGLES = np.arange(RAYS) * 2.0 * np.pi / RAYS - np.pi
seen = {"command": Twist()}


def on_state(message):
    if not {"vehicle", "footprint"} <= seen.keys():
        return
    answer = TwistStamped(header=message.header, twist=seen["command"])
    answer.header.frame_id = "base_link"
    twist.publish(answer)
    now, lever = node.get_clock().now().to_msg(), seen["vehicle"]["rear_axle_to_centre"]
    turn = message.pose.pose.orientation
    odometry = Odometry(child_frame_id="base_link", pose=message.pose, twist=message.twist)
    odometry.header.stamp, odometry.header.frame_id = now, "odom"
    place = odometry.pose.pose.position
    place.x -= lever * (1.0 - 2.0 * turn.z**2)
    place.y -= lever * 2.0 * turn.z * turn.w
    odom.publish(odometry)
    frames = [TransformStamped(child_frame_id="odom"), TransformStamped(child_frame_id="base_link")]
    for frame, parent in zip(frames, ("map", "odom"), strict=True):
        frame.header.stamp, frame.header.frame_id = now, parent
    moved = frames[1].transform
    moved.translation.x, moved.translation.y, moved.rotation = place.x, place.y, turn
    tf.publish(TFMessage(transforms=frames))
    for footprint in footprints:
        footprint.publish(seen["footprint"])
    if "objects" in seen:
        yaw = 2.0 * np.arctan2(turn.z, turn.w)
        message = LaserScan(angle_min=ANGLES[0], angle_max=ANGLES[-1], angle_increment=ANGLES[1] - ANGLES[0])
        message.header.stamp, message.header.frame_id = now, "base_link"
        message.scan_time, message.range_min, message.range_max = 0.1, 0.1, REACH
        message.ranges = scan(seen["objects"], complex(place.x, place.y), yaw).astype(np.float32).tolist()
        laser.publish(message)


def scan(objects, at, yaw):
    """(RAYS,) distances to the boxes around a place `at` [m]; infinite where there is none within REACH."""
    boxes = np.frombuffer(objects.data, {f.name: (" bBhHiIfd"[f.datatype], f.offset) for f in objects.fields})
    boxes = boxes[abs(boxes["x64"] + 1j * boxes["y64"] - at) < REACH + 10.0]
    centre = (boxes["x64"] + 1j * boxes["y64"] - at)[:, None]
    corner = 0.5 * (boxes["length"][:, None] * [1, -1, -1, 1] + 1j * boxes["width"][:, None] * [1, 1, -1, -1])
    corners = (centre + corner * np.exp(1j * boxes["yaw"])[:, None]) * np.exp(-1j * yaw)
    begin, along = corners.ravel(), (np.roll(corners, -1, axis=1) - corners).ravel()
    ray = np.exp(1j * ANGLES)[:, None]  # ray * distance = begin + along * share
    across = (along.conj() * ray).imag
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (along.conj() * begin).imag / across
        share = (ray.conj() * begin).imag / -(ray.conj() * along).imag
    hit = np.where((distance > 0.0) & (distance < REACH) & (share >= 0.0) & (share <= 1.0), distance, np.inf)
    return hit.min(axis=1, initial=np.inf)


def on_vehicle(message):
    seen["vehicle"] = {value.key: float(value.value) for value in message.status[0].values}


def on_footprint(message):
    seen["footprint"] = message.polygon


def on_diagnostics(message):
    if {"FINISHED", "FAILED"} & {value.value for status in message.status for value in status.values}:
        raise SystemExit


if __name__ == "__main__":
    rclpy.init()
    node = rclpy.create_node("nav2_bridge")
    odom, tf = node.create_publisher(Odometry, "/odom", 10), node.create_publisher(TFMessage, "/tf", 10)
    laser = node.create_publisher(LaserScan, "/scan", 10)
    footprints = [node.create_publisher(Polygon, f"/{name}_costmap/footprint", 10) for name in ("local", "global")]
    twist = node.create_publisher(TwistStamped, "/litsim/ego/twist", 10)
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    goal = node.create_publisher(PoseStamped, "/goal_pose", latched)
    node.create_subscription(PoseStamped, "/litsim/ego/goal", goal.publish, latched)
    node.create_subscription(DiagnosticArray, "/litsim/ego/vehicle", on_vehicle, latched)
    node.create_subscription(PolygonStamped, "/litsim/ego/footprint", on_footprint, latched)
    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    node.create_subscription(Odometry, "/litsim/ego/state", on_state, 10)
    node.create_subscription(PointCloud2, "/litsim/objects", lambda message: seen.update(objects=message), 10)
    node.create_subscription(Twist, "/cmd_vel", lambda message: seen.update(command=message), 10)
    rclpy.spin(node)
