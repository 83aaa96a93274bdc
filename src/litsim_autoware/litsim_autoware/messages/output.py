"""Publishers that write nothing while nobody listens: publishing costs most of a step, also without a subscriber."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile

QOS = QoSProfile(depth=1)  # of all topics of Autoware that are not latched


class Output:
    """A publisher of serialised messages; without a topic nobody ever listens.

    Attributes:
        listeners: number of subscribers, as of the last time that the node was served. Asking the middleware takes half
            as long as publishing.
    """

    def __init__(self, node: Node, kind: Any, topic: str | None, qos: QoSProfile = QOS) -> None:
        self.listeners = 0
        events = PublisherEventCallbacks(matched=self._on_matched)
        self._publisher = node.create_publisher(kind, topic, qos, event_callbacks=events) if topic else None

    def publish(self, write: Callable[[], bytes]) -> None:
        """Publishes the message that a function writes, which is only called if anybody listens."""
        if self.listeners and self._publisher is not None:
            self._publisher.publish(write())

    def _on_matched(self, change: Any) -> None:
        self.listeners = change.current_count
