"""A driving system on standard messages alone: along the route, behind the car ahead. Argument: twist or trajectory."""

import sys

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.time import Duration, Time
from sensor_msgs.msg import PointCloud2

WANTED, OF_A_STEP, INTERFACE, seen = 12.0, 0.1, sys.argv[1], {}  # [m/s], [s]


def on_input(message):
    seen[type(message)] = message
    route, ego, objects = (seen.get(kind) for kind in (Path, Odometry, PointCloud2))
    if route and ego and objects and ego.header.stamp == objects.header.stamp:  # a step is complete: answer it
        names = [field.name for field in objects.fields]
        formats = [{2: "u1", 6: "<u4", 7: "<f4"}[field.datatype] for field in objects.fields]
        offsets, size = [field.offset for field in objects.fields], objects.point_step
        dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
        publisher.publish(plan(route, ego, np.frombuffer(objects.data, dtype)))


def plan(route, ego, cars):
    pose, speed = ego.pose.pose, ego.twist.twist.linear.x
    at, yaw = complex(pose.position.x, pose.position.y), 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    away = (cars["x"] + 1j * cars["y"] - at) * np.exp(-1j * yaw)  # ahead, and to the left
    gap = np.min(away.real[(away.real > 0) & (abs(away.imag) < 1.8)], initial=100.0) - 7.0
    corners = np.array([complex(p.pose.position.x, p.pose.position.y) for p in route.poses])
    metres = np.append(0.0, np.cumsum(abs(np.diff(corners))))
    line = np.interp(np.arange(metres[-1]), metres, corners)
    answer = Path(header=ego.header) if INTERFACE == "trajectory" else TwistStamped(header=ego.header)
    for step in range(1, 31):
        speed += np.clip(min(WANTED, max(0.0, gap / 1.5)) - speed, -4.0 * OF_A_STEP, 1.0 * OF_A_STEP)
        target = line[np.argmin(abs(line - at)) + 10 :][0]  # pure pursuit of a point 10 m further on
        turn = 0.2 * speed * np.sin(np.angle(target - at) - yaw)
        if INTERFACE == "twist":  # what to do in this step
            answer.header.frame_id, answer.twist.linear.x, answer.twist.angular.z = "ego", float(speed), float(turn)
            return answer
        yaw, at = yaw + OF_A_STEP * turn, at + OF_A_STEP * speed * np.exp(1j * yaw)
        later = Time.from_msg(ego.header.stamp) + Duration(seconds=step * OF_A_STEP)
        there = PoseStamped()  # or where to be for the next three seconds
        there.header.frame_id, there.header.stamp = "map", later.to_msg()
        there.pose.position.x, there.pose.position.y = at.real, at.imag
        answer.poses.append(there)
    return answer


def on_diagnostics(array):
    said = [value.value for status in array.status if status.name == "litsim: bridge" for value in status.values]
    if {"FINISHED", "FAILED"} & set(said):
        sys.exit(0)


rclpy.init()
node, kind = rclpy.create_node("minimal_ads"), Path if INTERFACE == "trajectory" else TwistStamped
publisher = node.create_publisher(kind, f"/litsim/ego/{INTERFACE}", 10)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(Path, "/litsim/ego/route", on_input, latched)
node.create_subscription(Odometry, "/litsim/ego/state", on_input, 100)
node.create_subscription(PointCloud2, "/litsim/objects", on_input, 100)
node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
rclpy.spin(node)
