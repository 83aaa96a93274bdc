"""The replay: publishes the messages of a bag as they were recorded, at their times."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from math import isnan, nan
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger

from litsim_sim.core.errors import InputError
from litsim_sim.nodes.keyboard import Keyboard
from litsim_sim.record.bag import BagReader, BagTopic
from litsim_sim.record.player import Player, checked_rate, is_latched, messages_of, offered_qos, selected
from litsim_sim.ros.definitions import message_class, type_hash
from litsim_sim.ros.parameters import check_set, undeclare_set
from litsim_sim.ros.process import process, serve

NAME = "replay"
ATTENTION_S = 0.05  # longest delay until a key is noticed
DELIVERY_S = 2.0  # longest wait for the delivery of the last messages
SEEK_S = 1.0  # jump of an arrow key
RATE_STEP = 1.25
KEYS = "space: pause, s: step, arrows: seek 1 s (paused: one step), + -: rate, q: quit"


class ReplayNode(Node):
    """Plays one bag; services ``~/pause`` and ``~/step``, parameters `rate`, `loop` and `seek_to`.

    Attributes:
        player: schedule of the messages.
        ended: whether the end has been requested.
    """

    def __init__(self, bag: Path, topics: Sequence[str] = (), **options: Any) -> None:
        """Open `bag` to play `topics` (default: all); raises as :class:`.player.Player`, which has the `options`."""
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True)
        names = undeclare_set(self)
        reader = BagReader(bag)
        if reader.problem:
            self.get_logger().warning(
                f"{reader.path}: {reader.problem}; playing what is there (--repair makes it whole)"
            )
        self._outlets: dict[str, Any] = {}
        playable = [topic for topic in selected(reader, topics) if self._open(topic)]
        latched = [topic.name for topic in playable if is_latched(topic)]
        self.player = Player(messages_of(reader, playable), latched, **options)
        self.ended = False
        self.declare_parameter("rate", self.player.rate)
        self.declare_parameter("loop", self.player.loop)
        about = "seconds from the first message; setting it seeks"
        self.declare_parameter("seek_to", nan, ParameterDescriptor(description=about))
        check_set(self, names)
        begin_s = self.get_parameter("seek_to").value
        if not isnan(begin_s) and (fault := self._beyond(begin_s)):
            raise InputError(fault)
        self._apply(self.get_parameters(["rate", "loop", "seek_to"]))
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._apply)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)

    def publish_due(self) -> float:
        """Publish the messages that are due; return the time until the next is due [s]."""
        for message in self.player.take(time.monotonic()):
            self._outlets[message.topic].publish(message.data)
        return self.player.wait_s(time.monotonic())

    def press(self, key: str) -> None:
        """Handle a key; others than those of :data:`KEYS` do nothing."""
        player, now = self.player, time.monotonic()
        match key:
            case " ":
                player.pause(not player.paused, now)
            case "s":
                player.step(now)
            case "right" if player.paused:
                player.step(now)
            case "left" if player.paused:
                player.step_back(now)
            case "right":
                player.seek(player.position_s(now) + SEEK_S, now)
            case "left":
                player.seek(player.position_s(now) - SEEK_S, now)
            case "+" | "=" | "-":
                with suppress(InputError):  # the limit of the rate is reached
                    player.set_rate(player.rate / RATE_STEP if key == "-" else player.rate * RATE_STEP, now)
            case "q":
                self.ended = True

    def deliver(self) -> None:
        """Wait until the subscribers have received the last messages."""
        until = time.monotonic() + DELIVERY_S
        for outlet in self._outlets.values():
            outlet.wait_for_all_acked(Duration(seconds=max(0.0, until - time.monotonic())))

    def status(self) -> str:
        """Returns time and rate in one line."""
        player = self.player
        state = "paused" if player.paused else "playing"
        at = player.position_s(time.monotonic())
        return f"{at:7.1f} / {player.duration_s:.1f} s  x{player.rate:.2f}  {state}{', loop' if player.loop else ''}"

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
        fault = ""
        for parameter in parameters:  # rclpy has checked their types
            if parameter.name == "rate":
                try:
                    checked_rate(parameter.value)
                except InputError as error:
                    fault = str(error)
            elif parameter.name == "seek_to":
                fault = self._beyond(parameter.value) or fault
        return SetParametersResult(successful=not fault, reason=fault)

    def _beyond(self, position_s: float) -> str:
        """Returns a text that says that a position is not in the bag; empty if it is."""
        inside = 0.0 <= position_s <= self.player.duration_s
        return "" if inside else f"seek_to is {position_s:g}, expected 0 to {self.player.duration_s:g} s"

    def _apply(self, parameters: list[Any]) -> None:
        now = time.monotonic()
        for parameter in parameters:
            if parameter.name == "rate":
                self.player.set_rate(float(parameter.value), now)
            elif parameter.name == "loop":
                self.player.loop = bool(parameter.value)
            elif parameter.name == "seek_to" and not isnan(parameter.value):
                self.player.seek(float(parameter.value), now)

    def _on_pause(self, request: Any, response: Any) -> Any:
        self.player.pause(request.data, time.monotonic())
        response.success, response.message = True, self.status().strip()
        return response

    def _on_step(self, _: Any, response: Any) -> Any:
        before = self.player.position_s(time.monotonic())
        self.player.step(time.monotonic())
        response.success = self.player.wait_s(time.monotonic()) == 0.0  # a message is due
        response.message = self.status().strip() if response.success else f"{before:.1f} s is the last step"
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
    """Play `bag` to its end, or until q or Ctrl-C; `options` are those of the node."""
    sys.argv[1:] = ros_arguments  # read by rclpy's initialisation
    with process(interrupted=0):
        node = ReplayNode(bag, topics, **options)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        begin = time.monotonic() + delay_s
        with Keyboard() as keyboard, _StatusLine(keyboard.there) as line:
            if keyboard.there:
                print(KEYS, file=sys.stderr)
            while not (node.ended or node.player.finished):
                wait = node.publish_due() if time.monotonic() >= begin else begin - time.monotonic()
                serve(executor, min(wait, ATTENTION_S))
                for key in keyboard.pressed():
                    node.press(key)
                line.show(node.status())
        node.deliver()


class _StatusLine:
    """A status line at the bottom of a terminal; prints nothing elsewhere."""

    def __init__(self, wanted: bool) -> None:
        self._wanted = wanted and sys.stderr.isatty()
        self._shown = ""

    def __enter__(self) -> _StatusLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            print(file=sys.stderr)

    def show(self, text: str) -> None:
        """Replace the line."""
        if self._wanted and text != self._shown:
            print(f"\r{text}\x1b[K", end="", file=sys.stderr, flush=True)
            self._shown = text
