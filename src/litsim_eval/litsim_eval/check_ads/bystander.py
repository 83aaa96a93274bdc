"""A bystander on the graph, which records the bridge's messages, the stack's answers and the endpoints of both."""

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

from litsim_eval.check_ads.trace import FAILED, FINISHED, Endpoint, Heard
from litsim_sim.core.scene import STEP_NS
from litsim_sim.core.stages import BRIDGE, RECORDER
from litsim_sim.core.topic_names import Interface
from litsim_sim.launch.middleware import middleware_in_use
from litsim_sim.nodes.diagnostics import BRIDGE_NAME, PORT_NAME
from litsim_sim.nodes.publishers import Owners, check_publishers
from litsim_sim.nodes.responses import RunFailed
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
        published_ns: times at which the bridge published each step, by this machine's clock [ns].
        heard: answers in order of arrival.
        discovered_s: seconds from :meth:`start` until a publisher of each interface was found.
        present: whether any such publisher is there now.
        state, counts, interface: latest values on ``/diagnostics``.
        remarks: all messages of the ego port on ``/diagnostics``.
        intrusions: texts on publishers on internal topics that are no nodes of the run.
    """

    def __init__(self, domain_id: int, internal: Owners) -> None:
        """Listens in `domain_id`; `internal` are the topics on which only their owners may publish."""
        self.published_ns: dict[int, list[int]] = {}
        self.heard: list[Heard] = []
        self.discovered_s: dict[Interface, float] = {}
        self.present = False
        self.state = ""
        self.counts: dict[str, int] = {}
        self.interface: Interface | None = None
        self.remarks: list[str] = []
        self.intrusions: list[str] = []
        self._internal = internal
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
                answer = CONVERT[interface](message)
                self.heard.append(Heard(answer, info["received_timestamp"], max(self.published_ns, default=-1)))

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
        """Resets the time from which :attr:`discovered_s` counts."""
        self._began = time.monotonic()

    @property
    def endpoints(self) -> tuple[Endpoint, ...]:
        """Publishers and subscriptions of the stack found so far, sorted by topic."""
        theirs = {endpoint for endpoint in self._endpoints.values() if endpoint.node not in OURS}
        return tuple(sorted(theirs, key=lambda e: (e.topic, e.node, e.publishes)))

    @property
    def over(self) -> bool:
        """Whether the bridge has reported the end of the run."""
        return self.state in (FINISHED, FAILED)

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
                self.discovered_s.setdefault(interface, time.monotonic() - self._began)
                self._note(topic, info, publishes=True)
        for topic in EGO_FEEDS:
            for info in self._node.get_subscriptions_info_by_topic(topic.name):
                self._note(topic, info, publishes=False)
        self.present = present
        if not self.intrusions:
            try:
                check_publishers(self._node, self._internal)
            except RunFailed as error:
                self.intrusions.append(str(error))

    def _note(self, topic: Topic, info: Any, *, publishes: bool) -> None:
        node = node_of(info)
        if node:
            problem = _mismatch(topic, info, publishes=publishes)
            self._endpoints[bytes(info.endpoint_gid)] = Endpoint(topic.name, node, publishes, problem)

    def _on_state(self, message: Any, info: Any) -> None:
        stamp = message.header.stamp
        step = round((stamp.sec * 10**9 + stamp.nanosec) / STEP_NS)
        self.published_ns.setdefault(step, []).append(info["source_timestamp"])

    def _on_diagnostics(self, array: Any) -> None:
        for status in array.status:
            values = {value.key: value.value for value in status.values}
            if status.name == BRIDGE_NAME:
                self.state = values.get("state", "")
            elif status.name == PORT_NAME:
                interface = values.pop("interface", "")
                self.interface = Interface(interface) if interface else None
                self.counts = {kind: int(count) for kind, count in values.items()}
                if status.message:
                    self.remarks.append(status.message)


def _mismatch(topic: Topic, info: Any, *, publishes: bool) -> str:
    """Returns why an endpoint of the stack and the bridge's on the same topic do not match; empty if they do."""
    kind = info.topic_type
    package, name = topic.type.__module__.split(".")[0], topic.type.__name__
    expected = f"{package}/msg/{name}"
    if kind != expected:
        return f"its type is {kind}, expected {expected}"
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
