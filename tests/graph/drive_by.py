"""A stack that knows nothing of LitSim: by /odom and a steering angle, or by /scan and a twist."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

rclpy.init()
node = rclpy.create_node("drive_by")
if sys.argv[1] == "ackermann":
    from ackermann_msgs.msg import AckermannDriveStamped

    drive = node.create_publisher(AckermannDriveStamped, "/drive", 10)

    def on_odometry(message: Odometry) -> None:
        answer = AckermannDriveStamped()
        answer.drive.speed, answer.drive.steering_angle = 14.0, 0.0
        drive.publish(answer)

    node.create_subscription(Odometry, "/odom", on_odometry, 10)
else:
    cmd_vel = node.create_publisher(Twist, "/cmd_vel", 10)

    def on_scan(message: Any) -> None:
        ahead = np.asarray(message.ranges)[len(message.ranges) // 2 - 3 : len(message.ranges) // 2 + 4].min()
        answer = Twist()
        answer.linear.x = float(np.clip((ahead - 8.0) / 1.5, 0.0, 14.0))
        cmd_vel.publish(answer)

    node.create_subscription(LaserScan, "/scan", on_scan, 10)
rclpy.spin(node)
