"""A stack that knows nothing of LitSim: by /odom and a steering angle, or by /odom, /scan and a twist.

It follows /plan, if there is one, and keeps the speed at which it begins; by /scan it brakes for what is ahead.
"""

import sys
from math import atan
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan

WHEELBASE, SPEED = 2.6, 14.0  # [m], [m/s] where it has none yet
seen: dict[str, Any] = {"curvature": 0.0}

rclpy.init()
node = rclpy.create_node("drive_by")


def on_plan(message: Path) -> None:
    way = np.array([pose.pose.position.x + 1j * pose.pose.position.y for pose in message.poses])
    along = np.append(0.0, np.cumsum(abs(np.diff(way))))
    seen.pop("speed", None)
    seen["plan"] = np.interp(np.arange(0.0, along[-1]), along, way)  # a point each metre


def look(message: Odometry) -> None:
    """Notes the speed to keep, and the curvature to a point of the plan ahead (pure pursuit)."""
    pose, speed = message.pose.pose, message.twist.twist.linear.x
    seen.setdefault("speed", speed if "plan" in seen else SPEED)
    if "plan" in seen:
        turn = complex(pose.orientation.w, pose.orientation.z) ** 2
        ahead = (seen["plan"] - (pose.position.x + 1j * pose.position.y)) / turn
        later = ahead[np.argmin(abs(ahead)) :]
        target = next((point for point in later if abs(point) > max(4.0, 0.8 * speed)), later[-1])
        seen["curvature"] = 2.0 * target.imag / max(abs(target) ** 2, 1.0)


latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(Path, "plan", on_plan, latched)
if sys.argv[1] == "ackermann":
    from ackermann_msgs.msg import AckermannDriveStamped

    drive = node.create_publisher(AckermannDriveStamped, "/drive", 10)

    def on_odometry(message: Odometry) -> None:
        look(message)
        answer = AckermannDriveStamped()
        answer.drive.speed, answer.drive.steering_angle = seen["speed"], atan(WHEELBASE * seen["curvature"])
        drive.publish(answer)

    node.create_subscription(Odometry, "/odom", on_odometry, 10)
else:
    cmd_vel = node.create_publisher(Twist, "/cmd_vel", 10)

    def on_scan(message: LaserScan) -> None:
        """Keeps 1.5 s from the nearest thing within the width of the vehicle, along the way that it steers."""
        if "speed" not in seen:
            return
        angle = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
        x, y = np.array(message.ranges) * [np.cos(angle), np.sin(angle)]
        in_way = (x > 0.0) & (abs(y - 0.5 * seen["curvature"] * x**2) < 1.2)
        answer = Twist()
        answer.linear.x = float(np.clip((x[in_way].min(initial=np.inf) - 8.0) / 1.5, 0.0, seen["speed"]))
        answer.angular.z = answer.linear.x * seen["curvature"]
        cmd_vel.publish(answer)

    node.create_subscription(Odometry, "/odom", look, 10)
    node.create_subscription(LaserScan, "/scan", on_scan, 10)
rclpy.spin(node)
