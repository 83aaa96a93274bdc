"""A bystander on the graph, which notes the bridge's messages, the stack's answers and the endpoints of both."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.duration import Infinite
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.signals import SignalHandlerOptions

from litsim_eval.check_ads.trace import Endpoint, Evidence, Heard
from litsim_sim.core.scene import STEP_NS
from litsim_sim.core.stages import BRIDGE, RECORDER
from litsim_sim.core.topic_names import Interface
from litsim_sim.launch.middleware import middleware_in_use
from litsim_sim.nodes.diagnostics import BRIDGE_NAME, PORT_NAME
from litsim_sim.nodes.publishers import Owners, check_publishers
from litsim_sim.nodes.responses import RunFailed
from litsim_sim.ros.definitions import type_name
from litsim_sim.ros.ego_port import CONVERT
from litsim_sim.ros.endpoints import node_of
from litsim_sim.ros.topics import DIAGNOSTICS, EGO_FEEDS, EGO_INPUTS, EGO_STATE, Topic

PROGRAM = "check_ads"
NAME = f"litsim_{PROGRAM}"
OURS = {f"/{name}" for name in (NAME, BRIDGE, RECORDER)}
ANY_PUBLISHER = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=2000)


class Bystander:
    """Listens in a domain, in a context of its own; a context manager.

    Attributes:
        present: whether a publisher of the stack is there now.
    """

    def __init__(self, domain_id: int, internal: Owners, evidence: Evidence) -> None:
        """Listens in `domain_id`, and adds to `evidence`; on the topics `internal` only their owners may publish."""
        self.present = False
        self._seen, self._internal = evidence, internal
        self._began = time.monotonic()
        self._endpoints: dict[bytes, Endpoint] = {}
        self._context = Context()
        with middleware_in_use(PROGRAM):
            rclpy.init(context=self._context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
            self._node = Node(NAME, context=self._context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        for interface, topic in EGO_INPUTS.items():

            def hear(message: Any, info: Any, interface: Interface = interface) -> None:
                evidence.heard.append(Heard(CONVERT[interface](message), info["received_timestamp"]))

            self._node.create_subscription(topic.type, topic.name, hear, ANY_PUBLISHER)
        self._node.create_subscription(EGO_STATE.type, EGO_STATE.name, self._on_state, EGO_STATE.qos)
        self._node.create_subscription(DIAGNOSTICS.type, DIAGNOSTICS.name, self._on_diagnostics, DIAGNOSTICS.qos)

    def __enter__(self) -> Bystander:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def start(self) -> None:
        """Resets the time from which :attr:`.Evidence.discovered_s` counts."""
        self._began = time.monotonic()

    @property
    def hears_bridge(self) -> bool:
        """Whether the bridge's publishers have been found."""
        return all(self._node.count_publishers(topic.name) for topic in (EGO_STATE, DIAGNOSTICS))

    def listen(self, seconds: float) -> None:
        """Processes messages for `seconds`, then look at the endpoints of the graph."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)
        self._look()

    def _look(self) -> None:
        """Records the endpoints; any publisher on a topic of the port counts as the stack's."""
        present = False
        for interface, topic in EGO_INPUTS.items():
            for info in self._node.get_publishers_info_by_topic(topic.name):
                present = True
                self._seen.discovered_s.setdefault(interface, time.monotonic() - self._began)
                self._note(topic, info, publishes=True)
        for topic in EGO_FEEDS:
            for info in self._node.get_subscriptions_info_by_topic(topic.name):
                self._note(topic, info, publishes=False)
        self.present = present
        theirs = {endpoint for endpoint in self._endpoints.values() if endpoint.node not in OURS}
        self._seen.endpoints = tuple(sorted(theirs, key=lambda e: (e.topic, e.node, e.publishes)))
        if not self._seen.intrusions:
            try:
                check_publishers(self._node, self._internal)
            except RunFailed as error:
                self._seen.intrusions.append(str(error))

    def _note(self, topic: Topic, info: Any, *, publishes: bool) -> None:
        node = node_of(info)
        if node:
            problem = _mismatch(topic, info, publishes=publishes)
            self._endpoints[bytes(info.endpoint_gid)] = Endpoint(topic.name, node, publishes, problem)

    def _on_state(self, message: Any, info: Any) -> None:
        stamp = message.header.stamp
        step = round((stamp.sec * 10**9 + stamp.nanosec) / STEP_NS)
        self._seen.published_ns.setdefault(step, []).append(info["source_timestamp"])

    def _on_diagnostics(self, array: Any) -> None:
        for status in array.status:
            values = {value.key: value.value for value in status.values}
            if status.name == BRIDGE_NAME:
                self._seen.state = values.get("state", "")
            elif status.name == PORT_NAME:
                interface = values.pop("interface", "")
                self._seen.interface = Interface(interface) if interface else None
                self._seen.counts = {kind: int(count) for kind, count in values.items()}
                if any(topic.name in status.message for topic in EGO_INPUTS.values()):
                    self._seen.remark(status.message)


def _mismatch(topic: Topic, info: Any, *, publishes: bool) -> str:
    """Returns why an endpoint of the stack and the bridge's on the same topic do not match; empty if they do."""
    if info.topic_type != (expected := type_name(topic.type)):
        return f"its type is {info.topic_type}, expected {expected}"
    theirs, ours = info.qos_profile, topic.qos
    for name in ("deadline", "lifespan", "liveliness_lease_duration"):  # unset there, infinite on the graph
        setattr(ours, name, Infinite)
    offered, requested = (theirs, ours) if publishes else (ours, theirs)
    verdict, reason = qos_check_compatible(offered, requested)
    if verdict != QoSCompatibility.ERROR:
        return ""
    words = (f"{profile.reliability.name} {profile.durability.name}" for profile in (offered, requested))
    sides = "offered {}, requested {}".format(*words)
    return f"{'publisher' if publishes else 'subscription'} does not match: {sides} ({reason.strip(' ;')})"
