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
TOPICS = {"/diagnostics": DiagnosticArray, "/litsim/ego/route": Path, "/litsim/ego/footprint": PolygonStamped}
TOPICS |= {
    "/litsim/lanes/table": PointCloud2,
    "/litsim/ego/state": Odometry,
    "/litsim/objects": PointCloud2,
    "/litsim/lights": PointCloud2,
}
seen = {}  # the newest message of every topic


def on_message(topic, message):
    seen[topic] = message
    said, route, box, lanes, ego, *clouds = map(seen.get, TOPICS)
    if said and {"FINISHED", "FAILED"} & {value.value for status in said.status for value in status.values}:
        raise SystemExit
    if (
        message is said
        or not all((route, box, lanes, ego, *clouds))
        or any(c.header.stamp != ego.header.stamp for c in clouds)
    ):
        return  # nothing to answer, or the inputs of the step are not complete
    del seen["/litsim/objects"]  # one answer each time that a step is published
    publisher.publish(plan(route, box, ego, *map(table, (lanes, *clouds))))


def table(cloud):
    """The points of a cloud, with its fields."""
    return np.frombuffer(cloud.data, {f.name: (" bBhHiIfd"[f.datatype], f.offset) for f in cloud.fields})


def plan(route, box, ego, lanes, others, lights):
    pose, speed = ego.pose.pose, ego.twist.twist.linear.x
    at, yaw = complex(pose.position.x, pose.position.y), 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    away = (others["x64"] + 1j * others["y64"] - at) * np.exp(-1j * yaw)  # [m] other agents: ahead, and to the left
    length = np.ptp([p.x for p in box.polygon.points])  # [m] of the ego
    apart = away.real - 0.5 * (others["length"] + length)  # [m] bumper to bumper
    gap = np.min(apart[(away.real > 0) & (abs(away.imag) < 1.8)], initial=100.0) - 2.5
    corners = np.array([complex(p.pose.position.x, p.pose.position.y) for p in route.poses])
    line = np.interp(np.arange(1000.0), np.append(0.0, np.cumsum(abs(np.diff(corners)))), corners)  # metre by metre
    here = np.argmin(abs(line[:-10] - at))
    entered = np.where(lanes["entered"] <= here, lanes["entered"], -1.0)  # NaN of lanes that the route does not use
    wanted = min(WANTED, lanes["speed_limit"][np.argmax(entered)])
    for light in lights[np.isin(lights["state"], (3, 4, 8))]:  # red, red and amber, amber
        ends = complex(light["x64"], light["y64"]), complex(light["exit_x64"], light["exit_y64"])
        stop, leave = (np.argmin(abs(line - end)) for end in ends)
        on_route = abs(line[stop] - ends[0]) < 1.5 and abs(line[leave] - ends[1]) < 1.5
        room = stop - here - 0.5 * length  # [m] from the front bumper to the stop line
        if on_route and room > (-1.0 if light["state"] < 8 else speed**2 / 7.0):  # at amber, if it can
            gap = min(gap, room - 1.0)
    answer = Path(header=ego.header)  # with the stamp of the step, in frame map
    for step in range(1, HORIZON + 1):
        speed += np.clip(min(wanted, max(0.0, gap / 1.5)) - speed, -4.0 * STEP_S, 1.0 * STEP_S)
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
for name, kind in TOPICS.items():
    qos = latched if kind in (Path, PolygonStamped) or name.endswith("table") else 100
    node.create_subscription(kind, name, lambda message, name=name: on_message(name, message), qos)
rclpy.spin(node)
