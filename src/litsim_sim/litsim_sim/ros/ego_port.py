"""Subscriptions of the ego port: messages of a driving system for :class:`litsim_sim.ego_port.port.EgoPort`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from litsim_msgs.msg import EgoControl
from nav_msgs.msg import Path
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from litsim_sim.core.scene import EgoCommand
from litsim_sim.core.topic_names import Interface
from litsim_sim.ego_port.answer import MAP_FRAME, Answer
from litsim_sim.ego_port.port import EgoPort, Level, Remark
from litsim_sim.ego_port.tracking import Trajectory, TwistTarget
from litsim_sim.ros.topics import EGO_INPUTS


def subscribe(node: Node, port: EgoPort, interfaces: tuple[Interface, ...]) -> None:
    """Pass messages on the topics of `interfaces` to `port`; log publishers whose QoS does not match."""
    for interface in interfaces:
        topic, convert = EGO_INPUTS[interface], CONVERT[interface]

        def receive(message: Any, convert: Callable[[Any], Answer] = convert) -> None:
            port.offer(convert(message))

        def mismatch(event: Any, name: str = topic.name) -> None:
            text = f"{name}: a publisher offers a QoS that does not match, expected reliability RELIABLE"
            port.remarks.append(Remark(0, Level.ERROR, text))
            node.get_logger().error(f"{text} ({event.total_count} such)")

        callbacks = SubscriptionEventCallbacks(incompatible_qos=mismatch)
        node.create_subscription(topic.type, topic.name, receive, topic.qos, event_callbacks=callbacks)


def from_control(message: EgoControl) -> Answer:
    """Acceleration and yaw rate, matched by run and step."""
    answer = Answer(Interface.CONTROL, None, step=message.step, run_id=message.run_id)
    try:
        return replace(answer, target=EgoCommand.of_message(message))
    except ValueError as error:
        return replace(answer, fault=str(error))


def from_twist(message: TwistStamped) -> Answer:
    """Target speed and yaw rate, matched by stamp."""
    target = TwistTarget(message.twist.linear.x, message.twist.angular.z)
    return Answer(Interface.TWIST, target, _nanoseconds(message.header.stamp), frame=message.header.frame_id)


def from_path(message: Path) -> Answer:
    """Poses at simulation times, matched by the stamp of the path itself."""
    frame = message.header.frame_id
    others = {pose.header.frame_id for pose in message.poses} - {"", frame}
    values = np.array(
        [(_nanoseconds(p.header.stamp) * 1e-9, p.pose.position.x, p.pose.position.y) for p in message.poses],
        np.float64,
    ).reshape(-1, 3)
    target = Trajectory(values[:, 0], values[:, 1], values[:, 2])
    frame = min(others) if others and frame == MAP_FRAME else frame
    return Answer(Interface.TRAJECTORY, target, _nanoseconds(message.header.stamp), frame=frame)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


CONVERT: dict[Interface, Callable[[Any], Answer]] = {
    Interface.CONTROL: from_control,
    Interface.TWIST: from_twist,
    Interface.TRAJECTORY: from_path,
}
"""Conversion of a message to an :class:`litsim_sim.ego_port.answer.Answer`, by interface."""
