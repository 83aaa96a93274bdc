"""A driving system on standard messages alone, as minimal_ads.py, that says where to be for the next three seconds."""

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.time import Duration, Time
from sensor_msgs.msg import PointCloud2

STEP_S, HORIZON = 0.1, 30  # [s], steps
WANTED = 12.0  # [m/s]
TOPICS = {DiagnosticArray: "/diagnostics", Path: "/litsim/ego/route", PolygonStamped: "/litsim/ego/footprint"}
TOPICS |= {Odometry: "/litsim/ego/state", PointCloud2: "/litsim/objects"}
seen = {}  # the newest message of every type


def on_message(message):
    seen[type(message)] = message
    said, route, box, ego, objects = map(seen.get, TOPICS)
    if said and {"FINISHED", "FAILED"} & {value.value for status in said.status for value in status.values}:
        raise SystemExit
    if message is said or not (route and box and ego and objects and ego.header.stamp == objects.header.stamp):
        return  # nothing to answer, or the inputs of the step are not complete
    del seen[PointCloud2]  # one answer each time that a step is published
    publisher.publish(plan(route, box, ego, objects))


def plan(route, box, ego, objects):
    others = np.frombuffer(objects.data, {f.name: (" bBhHiIfd"[f.datatype], f.offset) for f in objects.fields})
    pose, speed = ego.pose.pose, ego.twist.twist.linear.x
    at, yaw = complex(pose.position.x, pose.position.y), 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    away = (others["x64"] + 1j * others["y64"] - at) * np.exp(-1j * yaw)  # [m] other agents: ahead, and to the left
    apart = away.real - 0.5 * (others["length"] + np.ptp([p.x for p in box.polygon.points]))  # [m] bumper to bumper
    gap = np.min(apart[(away.real > 0) & (abs(away.imag) < 1.8)], initial=100.0) - 2.5
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
for kind, topic in TOPICS.items():
    node.create_subscription(kind, topic, on_message, latched if kind in (Path, PolygonStamped) else 100)
rclpy.spin(node)
