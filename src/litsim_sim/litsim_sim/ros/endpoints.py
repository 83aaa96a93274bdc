"""Publishers and subscriptions of the graph's topics that cost a waiting node as little as they can.

rclpy's executor goes through all that a node might wait for whenever it waits. By default each publisher and each
subscription brings two events along, which would warn of QoS and types that do not match; between LitSim's own nodes,
which take both from one place, they cannot differ, and foreign nodes are warned by their own side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher

from litsim_sim.ros.topics import Topic


def publisher_on(node: Node, topic: Topic) -> Publisher:
    """A publisher of `node` on `topic`."""
    silent = PublisherEventCallbacks(use_default_callbacks=False)
    return node.create_publisher(topic.type, topic.name, topic.qos, event_callbacks=silent)


def subscribe(node: Node, topic: Topic, receive: Callable[[Any], None], *, raw: bool = False) -> None:
    """Have `node` call `receive` with what comes on `topic`: messages, or their serialised form where it is `raw`."""
    silent = SubscriptionEventCallbacks(use_default_callbacks=False)
    node.create_subscription(topic.type, topic.name, receive, topic.qos, raw=raw, event_callbacks=silent)
