"""A driving system on standard messages alone, as minimal_ads.py, that says where to be for the next three seconds."""

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.time import Duration, Time
from sensor_msgs.msg import PointCloud2

STEP_S, HORIZON = 0.1, 30  # [s], steps
WANTED = 12.0  # [m/s]
seen = {}  # the newest message of every type


def on_message(message):
    seen[type(message)] = message
    route, ego, objects, said = (seen.get(kind) for kind in (Path, Odometry, PointCloud2, DiagnosticArray))
    if said and {"FINISHED", "FAILED"} & {value.value for status in said.status for value in status.values}:
        raise SystemExit
    if message is said or not (route and ego and objects and ego.header.stamp == objects.header.stamp):
        return  # nothing to answer, or the inputs of the step are not complete
    del seen[PointCloud2]  # one answer each time that a step is published
    publisher.publish(plan(route, ego, objects))


def plan(route, ego, objects):
    offset = {field.name: field.offset for field in objects.fields}
    rows = np.frombuffer(objects.data, np.uint8).reshape(-1, objects.point_step)
    x, y = (rows[:, offset[name] : offset[name] + 8].copy().view("<f8")[:, 0] for name in ("x64", "y64"))
    pose, speed = ego.pose.pose, ego.twist.twist.linear.x
    at, yaw = complex(pose.position.x, pose.position.y), 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    away = (x + 1j * y - at) * np.exp(-1j * yaw)  # [m] other agents: ahead, and to the left
    gap = np.min(away.real[(away.real > 0) & (abs(away.imag) < 1.8)], initial=100.0) - 7.0
    corners = np.array([complex(p.pose.position.x, p.pose.position.y) for p in route.poses])
    line = np.interp(np.arange(1000.0), np.append(0.0, np.cumsum(abs(np.diff(corners)))), corners)  # metre by metre
    answer = Path(header=ego.header)  # with the stamp of the step, in frame map
    for step in range(1, HORIZON + 1):
        speed += np.clip(min(WANTED, max(0.0, gap / 1.5)) - speed, -4.0 * STEP_S, 1.0 * STEP_S)
        target = line[np.argmin(abs(line[:-10] - at)) + 10]  # 10 m further on: pure pursuit
        yaw += STEP_S * 0.2 * speed * np.sin(np.angle(target - at) - yaw)
        at += STEP_S * speed * np.exp(1j * yaw)
        there = PoseStamped()
        there.header.frame_id = "map"
        there.header.stamp = (Time.from_msg(ego.header.stamp) + Duration(seconds=step * STEP_S)).to_msg()
        there.pose.position.x, there.pose.position.y = at.real, at.imag
        answer.poses.append(there)
    return answer


rclpy.init()
node = rclpy.create_node("trajectory_ads")
publisher = node.create_publisher(Path, "/litsim/ego/trajectory", 10)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
for kind, topic in (Odometry, "/litsim/ego/state"), (PointCloud2, "/litsim/objects"), (DiagnosticArray, "/diagnostics"):
    node.create_subscription(kind, topic, on_message, 100)
node.create_subscription(Path, "/litsim/ego/route", on_message, latched)
rclpy.spin(node)
