"""An ego whose timer runs on simulation time: keeps its speed; writes the times that it hears on /clock to a file."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

times: list[int] = []
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
        Path(sys.argv[2]).write_text(json.dumps(times))
        raise SystemExit


rclpy.init()
node = rclpy.create_node("timer_ego", parameter_overrides=[Parameter("use_sim_time", value=True)])
publisher = node.create_publisher(TwistStamped, "/litsim/ego/twist", 10)
node.create_subscription(Odometry, "/litsim/ego/state", lambda message: states.__setitem__(slice(None), [message]), 10)
node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
node.create_subscription(Clock, "/clock", lambda m: times.append(m.clock.sec * 10**9 + m.clock.nanosec), 1000)
node.create_timer(float(sys.argv[1]), on_timer)
rclpy.spin(node)
