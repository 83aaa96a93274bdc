"""The replay: publishes the messages of a bag as they were recorded, at their times."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool

from litsim_sim.record.bag import BagReader, BagTopic
from litsim_sim.record.player import Player, is_latched, messages_of, offered_qos, selected
from litsim_sim.ros.definitions import message_class, type_hash
from litsim_sim.ros.parameters import refuse_parameters
from litsim_sim.ros.process import process, serve

NAME = "replay"
SEEK = "seek_to"  # parameter
ATTENTION_S = 0.05  # longest delay until the end of a run is noticed
DELIVERY_S = 2.0  # longest wait for the delivery of the last messages


class ReplayNode(Node):
    """Plays one bag, on the schedule of its `player`; service ``~/pause``, parameter `seek_to`."""

    def __init__(self, bag: Path, topics: Sequence[str] = (), **options: Any) -> None:
        """Open `bag` to play `topics` (default: all); raises as :class:`.player.Player`, which has the `options`."""
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True)
        refuse_parameters(self)
        reader = BagReader(bag)
        if reader.problem:
            self.get_logger().warning(f"{reader.path}: {reader.problem}; playing what is there")
        self._outlets: dict[str, Any] = {}
        playable = [topic for topic in selected(reader, topics) if self._open(topic)]
        latched = [topic.name for topic in playable if is_latched(topic)]
        self.player = Player(messages_of(reader, playable), latched, **options)
        about = "seconds from the first message; setting it seeks"
        self.declare_parameter(SEEK, 0.0, ParameterDescriptor(description=about))
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._apply)
        self.create_service(SetBool, "~/pause", self._on_pause)

    def publish_due(self) -> float:
        """Publish the messages that are due; return the time until the next is due [s]."""
        for message in self.player.take(time.monotonic()):
            self._outlets[message.topic].publish(message.data)
        return self.player.wait_s(time.monotonic())

    def deliver(self) -> None:
        """Wait until the subscribers have received the last messages."""
        until = time.monotonic() + DELIVERY_S
        for outlet in self._outlets.values():
            outlet.wait_for_all_acked(Duration(seconds=max(0.0, until - time.monotonic())))

    def _open(self, topic: BagTopic) -> bool:
        """Create a publisher; return False, with a warning, if subscribers here could not read the messages."""
        try:
            message_type = message_class(topic.type_name)
            here = type_hash(topic.type_name)
        except (ImportError, AttributeError, LookupError):
            self.get_logger().warning(f"{topic.name} is left out: {topic.type_name} is not installed")
            return False
        if topic.type_hash and here and topic.type_hash != here:
            self.get_logger().warning(f"{topic.name} is left out: recorded with another version of {topic.type_name}")
            return False
        self._outlets[topic.name] = self.create_publisher(message_type, topic.name, qos_of(topic))
        return True

    def _check(self, parameters: list[Any]) -> Any:
        last = self.player.duration_s
        beyond = [p.value for p in parameters if p.name == SEEK and not 0.0 <= p.value <= last]  # of the right type
        fault = f"{SEEK} is {beyond[0]:g}, expected 0 to {last:g} s" if beyond else ""
        return SetParametersResult(successful=not fault, reason=fault)

    def _apply(self, parameters: list[Any]) -> None:
        for parameter in parameters:
            if parameter.name == SEEK:
                self.player.seek(parameter.value, time.monotonic())

    def _on_pause(self, request: Any, response: Any) -> Any:
        now = time.monotonic()
        self.player.pause(request.data, now)
        response.success = True
        response.message = f"at {self.player.position_s(now):.1f} of {self.player.duration_s:.1f} s"
        return response


def qos_of(topic: BagTopic) -> QoSProfile:
    """Returns the recorded QoS, with rclpy's defaults for missing and system-dependent policies."""
    offered = offered_qos(topic)
    depth = int(offered.get("depth") or 0) or 10
    keep_all = offered.get("history") == "keep_all"
    best_effort = offered.get("reliability") == "best_effort"
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched(topic) else DurabilityPolicy.VOLATILE,
    )


def play(bag: Path, ros_arguments: Sequence[str], topics: Sequence[str], delay_s: float, **options: Any) -> None:
    """Play `bag` to its end, or until Ctrl-C; `options` are those of :class:`.player.Player`."""
    sys.argv[1:] = ros_arguments  # read by rclpy's initialisation
    with process(interrupted=0):
        node = ReplayNode(bag, topics, **options)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        begin = time.monotonic() + delay_s
        while not node.player.finished:
            wait = node.publish_due() if time.monotonic() >= begin else begin - time.monotonic()
            serve(executor, min(wait, ATTENTION_S))
        node.deliver()
