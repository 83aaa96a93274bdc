"""Somebody else's stack on standard messages alone, at constant speed straight on; it goes wrong in one way."""

import argparse
import os
import time

import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rclpy.utilities import remove_ros_args

STEP_NS = 100_000_000
LEAVING_S = 3.0
"""[s] for which it is still there: the name of its node reaches a busy machine's bridge after what it publishes."""
RELIABILITY = {"reliable": ReliabilityPolicy.RELIABLE, "best_effort": ReliabilityPolicy.BEST_EFFORT}
FAULTS = ("none", "flood", "silence", "death", "steady")
STEADY_S = 0.1  # [s] for every step, but not for its repetitions


class StandardEgo(Node):
    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("standard_ego")
        self.options = options
        self.path = options.interface == "trajectory"
        self.seen = -1
        self.last: Path | TwistStamped | None = None
        kinds = {"twist": TwistStamped, "trajectory": Path}
        qos = QoSProfile(depth=10, reliability=RELIABILITY[options.reliability])
        self.publisher = self.create_publisher(kinds[options.interface], options.topic, qos)
        if options.fault == "flood":
            self.create_timer(0.001, self.repeat)
        self.create_subscription(Odometry, "/litsim/ego/state", self.on_state, 100)

    def repeat(self) -> None:
        if self.last is not None:
            self.publisher.publish(self.last)

    def on_state(self, state: Odometry) -> None:
        step = Time.from_msg(state.header.stamp).nanoseconds // STEP_NS
        fault = self.options.fault if step >= self.options.at else "none"
        if self.options.fault == "steady" and step > self.seen:
            time.sleep(STEADY_S)
        self.seen = step
        if fault == "death":
            time.sleep(LEAVING_S)
            os._exit(3)
        if fault == "silence":
            return
        self.last = self.answer(state, step)
        self.publisher.publish(self.last)

    def answer(self, state: Odometry, step: int) -> Path | TwistStamped:
        speed = state.twist.twist.linear.x
        if not self.path:
            twist = TwistStamped()
            twist.header.stamp = Time(nanoseconds=step * STEP_NS).to_msg()
            twist.header.frame_id = "base_link"
            twist.twist.linear.x = speed
            return twist
        path = Path()
        path.header.stamp = Time(nanoseconds=step * STEP_NS).to_msg()
        path.header.frame_id = "map"
        at = state.pose.pose.position
        for ahead in range(21):
            pose = PoseStamped()
            pose.header.stamp = Time(nanoseconds=(step + ahead) * STEP_NS).to_msg()
            pose.pose.position.x, pose.pose.position.y = at.x + 0.1 * ahead * speed, at.y
            path.poses.append(pose)
        return path


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--interface", choices=("twist", "trajectory"), default="twist")
    parser.add_argument("--topic")
    parser.add_argument("--reliability", choices=RELIABILITY, default="reliable")
    parser.add_argument("--fault", choices=FAULTS, default="none")
    parser.add_argument("--at", type=int, default=12, metavar="STEP")
    rclpy.init()
    options = parser.parse_args(remove_ros_args()[1:])
    options.topic = options.topic or f"/litsim/ego/{options.interface}"
    node = StandardEgo(options)
    print("ready", flush=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
