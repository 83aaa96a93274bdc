"""A driving system on standard messages alone: along the route, within limits, 1.5 s behind others, halting at red."""

from contextlib import suppress

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.executors import ExternalShutdownException
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2

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
        seen.clear()  # the run is over, and another may follow
        return
    if (
        message is said
        or not all((route, box, lanes, ego, *clouds))
        or any(c.header.stamp != ego.header.stamp for c in clouds)
    ):
        return  # nothing to answer, or the inputs of the step are not complete
    del seen["/litsim/objects"]  # one answer each time that a step is published
    layouts = ({f.name: (" bBhHiIfd"[f.datatype], f.offset) for f in cloud.fields} for cloud in (lanes, *clouds))
    lanes, others, lights = map(np.frombuffer, (cloud.data for cloud in (lanes, *clouds)), layouts)
    pose, speed = ego.pose.pose, ego.twist.twist.linear.x
    at, yaw = complex(pose.position.x, pose.position.y), 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    length = np.ptp([p.x for p in box.polygon.points])  # [m] of the ego
    away = (others["x64"] + 1j * others["y64"] - at) * np.exp(-1j * yaw)  # [m] other agents: ahead, and to the left
    apart = away.real - 0.5 * (others["length"] + length)  # [m] bumper to bumper
    gap = np.min(apart[(away.real > 0) & (abs(away.imag) < 1.8)], initial=100.0) - 2.5
    corners = np.array([complex(p.pose.position.x, p.pose.position.y) for p in route.poses])
    line = np.interp(np.arange(1000.0), np.append(0.0, np.cumsum(abs(np.diff(corners)))), corners)  # metre by metre
    here = np.argmin(abs(line[:-10] - at))
    entered = np.where(lanes["entered"] <= here, lanes["entered"], -1.0)  # NaN of lanes that the route does not use
    wanted = min(12.0, lanes["speed_limit"][np.argmax(entered)])
    for light in lights[np.isin(lights["state"], (3, 4, 8))]:  # red, red and amber, amber
        ends = complex(light["x64"], light["y64"]), complex(light["exit_x64"], light["exit_y64"])
        stop, leave = (np.argmin(abs(line - end)) for end in ends)
        on_route = abs(line[stop] - ends[0]) < 1.5 and abs(line[leave] - ends[1]) < 1.5
        room = stop - here - 0.5 * length  # [m] from the front bumper to the stop line
        if on_route and room > (-1.0 if light["state"] < 8 else speed**2 / 7.0):  # at amber, if it can
            gap = min(gap, room - 1.0)
    answer = TwistStamped(header=ego.header)  # with the stamp of the step
    answer.header.frame_id = "ego"
    answer.twist.linear.x = float(speed + np.clip(min(wanted, max(0.0, gap / 1.5)) - speed, -0.4, 0.1))
    answer.twist.angular.z = float(0.2 * speed * np.sin(np.angle(line[here + 10] - at) - yaw))  # pure pursuit
    publisher.publish(answer)


rclpy.init()
node = rclpy.create_node("minimal_ads")
publisher = node.create_publisher(TwistStamped, "/litsim/ego/twist", 10)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
for name, kind in TOPICS.items():
    qos = latched if kind in (Path, PolygonStamped) or name.endswith("table") else 100
    node.create_subscription(kind, name, lambda message, name=name: on_message(name, message), qos)
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(node)
