"""Publishers and subscriptions of the graph's topics that cost a waiting node as little as they can; whose they are.

rclpy's executor goes through all that a node might wait for whenever it waits. By default each publisher and each
subscription brings two events along, which would warn of QoS and types that do not match; between LitSim's own nodes,
which take both from one place, they cannot differ, and foreign nodes are warned by their own side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher

from litsim_sim.ros.topics import Topic

NAMELESS = "_NODE_NAME_UNKNOWN_"
"""What the middleware calls the node of an endpoint that it has found before its node, or that outlives it."""


@dataclass(frozen=True)
class Endpoints:
    """What a node may publish and hear, of which a run may need a part; its class holds it as `declared`.

    Nodes make no other endpoints on LitSim's topics: :mod:`litsim_sim.ros.security` allows them what stands here.

    Attributes:
        node: name of the node.
        publishes: topics that it has publishers on.
        hears: topics that it has subscriptions on.
    """

    node: str
    publishes: tuple[Topic, ...]
    hears: tuple[Topic, ...]


def publisher_on(node: Node, topic: Topic) -> Publisher:
    """A publisher of `node` on `topic`."""
    silent = PublisherEventCallbacks(use_default_callbacks=False)
    return node.create_publisher(topic.type, topic.name, topic.qos, event_callbacks=silent)


def subscribe(
    node: Node, topic: Topic, receive: Callable[[Any], None], *, raw: bool = False, depth: int | None = None
) -> None:
    """Have `node` call `receive` with what comes on `topic`: messages, or their serialised form where it is `raw`.

    Of a topic that is not latched, up to `depth` messages wait to be served, else as many as the topic says.
    """
    silent, qos = SubscriptionEventCallbacks(use_default_callbacks=False), topic.qos
    if depth is not None and not topic.latched:
        qos.depth = depth
    node.create_subscription(topic.type, topic.name, receive, qos, raw=raw, event_callbacks=silent)


def node_of(endpoint: Any) -> str:
    """Full name of the node of an endpoint, as rclpy's TopicEndpointInfo has it; empty where it is not known."""
    return "" if endpoint.node_name == NAMELESS else f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
