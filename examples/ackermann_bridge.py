"""Lets a stack with Ackermann steering drive, such as one of F1TENTH: odometry out, speed and steering angle in.

    ./litsim launch --ego external --mode realtime -- python3 examples/ackermann_bridge.py
    ros2 run YOUR_PACKAGE YOUR_NODE     # in the same domain: reads /odom, publishes /drive

/odom is the middle of the rear axle in frame odom. The first command after a step answers it. A launch file that starts
the stack and this script can be the command after `--`. Needs ackermann_msgs.
"""

from math import tan

import rclpy
from ackermann_msgs.msg import AckermannDriveStamped
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSDurabilityPolicy, QoSProfile

seen = {}  # the vehicle's values by name, and the state of the ego that waits for an answer


def on_vehicle(message):
    seen["vehicle"] = {value.key: float(value.value) for value in message.status[0].values}


def on_state(message):
    if "vehicle" not in seen:
        return
    seen["state"] = message
    odometry = Odometry(header=message.header, child_frame_id="base_link", pose=message.pose, twist=message.twist)
    turn, place = message.pose.pose.orientation, odometry.pose.pose.position
    lever = seen["vehicle"]["rear_axle_to_centre"]
    place.x -= lever * (1.0 - 2.0 * turn.z**2)
    place.y -= lever * 2.0 * turn.z * turn.w
    odometry.header.frame_id = "odom"  # the same frame as map
    odom.publish(odometry)


def on_drive(message):
    if "state" in seen:
        answer = TwistStamped()
        answer.header.stamp, answer.header.frame_id = seen.pop("state").header.stamp, "base_link"
        answer.twist.linear.x = message.drive.speed
        answer.twist.angular.z = message.drive.speed * tan(message.drive.steering_angle) / seen["vehicle"]["wheelbase"]
        twist.publish(answer)


def on_diagnostics(message):
    if {"FINISHED", "FAILED"} & {value.value for status in message.status for value in status.values}:
        raise SystemExit


rclpy.init()
node = rclpy.create_node("ackermann_bridge")
odom = node.create_publisher(Odometry, "/odom", 10)
twist = node.create_publisher(TwistStamped, "/litsim/ego/twist", 10)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(DiagnosticArray, "/litsim/ego/vehicle", on_vehicle, latched)
node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
node.create_subscription(Odometry, "/litsim/ego/state", on_state, 10)
node.create_subscription(AckermannDriveStamped, "/drive", on_drive, 10)
rclpy.spin(node)
