"""An ego whose timer runs on simulation time keeps its speed, and writes what it hears of time and frames to a file."""

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

times: list[int] = []
corners: list[tuple[float, float]] = []
frames: list[tuple[str, str, int, float, float]] = []  # parent, child, stamp [ns], x, y [m]
states: list[Odometry] = []


def on_timer() -> None:
    if states:
        answer = TwistStamped(header=states[0].header)
        answer.header.frame_id = "base_link"
        answer.twist = states[0].twist.twist
        publisher.publish(answer)
        states.clear()


def on_diagnostics(message: DiagnosticArray) -> None:
    if {"FINISHED", "FAILED"} & {value.value for status in message.status for value in status.values}:
        Path(sys.argv[2]).write_text(json.dumps({"times": times, "corners": corners, "frames": frames}))
        raise SystemExit


def on_footprint(message: PolygonStamped) -> None:
    assert message.header.frame_id == "base_link"
    corners[:] = [(point.x, point.y) for point in message.polygon.points]


def on_frames(message: Any) -> None:
    for each in message.transforms:
        stamp, place = each.header.stamp, each.transform.translation
        moved = (stamp.sec * 10**9 + stamp.nanosec, place.x, place.y)
        frames.append((each.header.frame_id, each.child_frame_id, *moved))


rclpy.init()
node = rclpy.create_node("timer_ego", parameter_overrides=[Parameter("use_sim_time", value=True)])
publisher = node.create_publisher(TwistStamped, "/litsim/ego/twist", 10)
node.create_subscription(Odometry, "/litsim/ego/state", lambda message: states.__setitem__(slice(None), [message]), 10)
node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
node.create_subscription(Clock, "/clock", lambda m: times.append(m.clock.sec * 10**9 + m.clock.nanosec), 1000)
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(PolygonStamped, "/litsim/ego/footprint", on_footprint, latched)
if find_spec("tf2_msgs"):
    from tf2_msgs.msg import TFMessage

    node.create_subscription(TFMessage, "/tf", on_frames, 100)
    node.create_subscription(TFMessage, "/tf_static", on_frames, latched)
node.create_timer(float(sys.argv[1]), on_timer)
rclpy.spin(node)
