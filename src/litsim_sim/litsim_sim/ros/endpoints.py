"""Publishers and subscriptions of the graph's topics with little overhead.

Whenever it waits, rclpy's executor iterates over all entities of a node. By default each publisher and subscription
adds two events that warn of mismatched QoS and types. LitSim's own nodes share one definition of both, so the events
are left out; foreign nodes get the warnings on their side.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher

from litsim_sim.ros.topics import Topic

T = TypeVar("T")

NAMES_S = 1.0  # [s] by which the names of nodes may follow their endpoints, at most
NAMELESS = "_NODE_NAME_UNKNOWN_"
"""Name that the middleware gives to the node of an endpoint discovered before its node, or outliving it."""


def publisher_on(node: Node, topic: Topic) -> Publisher:
    """Returns a publisher of `node` on `topic`."""
    silent = PublisherEventCallbacks(use_default_callbacks=False)
    return node.create_publisher(topic.type, topic.name, topic.qos, event_callbacks=silent)


def subscribe(
    node: Node,
    topic: Topic,
    receive: Callable[[Any], None],
    *,
    raw: bool = False,
    depth: int | None = None,
    matched: Callable[[Any], None] | None = None,
) -> None:
    """Subscribe `node` to `topic`; `receive` gets messages, or their serialised form if `raw`.

    `depth` is the length of the queue; the topic's if None, and always for latched topics. `matched` is called when
    publishers come and go, with their counts; it must not raise, or the events executor ends the process.
    """
    silent, qos = SubscriptionEventCallbacks(matched=matched, use_default_callbacks=False), topic.qos
    if depth is not None and not topic.latched:
        qos.depth = depth
    node.create_subscription(topic.type, topic.name, receive, qos, raw=raw, event_callbacks=silent)


def node_of(endpoint: Any) -> str:
    """Full name of the node of a TopicEndpointInfo of rclpy; empty if unknown."""
    return "" if endpoint.node_name == NAMELESS else f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def once_named(look: Callable[[], list[T]], name: Callable[[T], str]) -> list[T]:
    """Returns what `look` finds, as soon as each has a `name` that is not empty, or after NAMES_S."""
    give_up = time.perf_counter() + NAMES_S
    while not all(map(name, endpoints := look())) and time.perf_counter() < give_up:
        time.sleep(0.01)
    return endpoints
