"""The live view: markers of the newest step for RViz and Foxglove, and optionally a WebSocket server.

The server also forwards the topics that a bag holds, so that one layout serves bags and live runs.

It should not slow down a run: no node waits for it, its subscriptions to the topics of the loop are best-effort, it
draws at its own rate and only what is being viewed, and it has a low priority.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Sequence
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from litsim_sim.core.scene import STEP_NS, AgentTable
from litsim_sim.nodes.live_server import LiveServer
from litsim_sim.ros import cdr
from litsim_sim.ros.markers import AgentLayer, ConflictLayer, ForecastLayer, modes_off_log
from litsim_sim.ros.parameters import refuse_parameters
from litsim_sim.ros.process import process, serve
from litsim_sim.ros.topics import (
    AGENTS,
    CLOCK,
    FORECASTS,
    FOREIGN,
    MARKERS,
    MARKERS_AGENTS,
    MARKERS_CONFLICTS,
    MARKERS_FORECASTS,
    RECORDED_TOPICS,
    TAKEOVERS,
    Topic,
)

NAME = "live"
DEPTH = 10  # messages of a topic that are queued at most; the oldest are dropped
NICENESS = 10  # gives priority to the loop where processors are scarce
DRAWN = (AGENTS, FORECASTS, TAKEOVERS)


class LiveNode(Node):
    """Draws the newest messages on request; forwards incoming ones to `server`, if there is one."""

    def __init__(self, server: LiveServer | None = None) -> None:
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True)
        refuse_parameters(self)
        self._server = server
        self._agents, self._forecasts, self._conflicts = AgentLayer(), ForecastLayer(), ConflictLayer()
        self._newest: dict[Topic, bytes] = {}
        self._fresh = False
        self._audience = dict.fromkeys(MARKERS, 0)
        self._time_ns = 0
        self._outlets = {topic: self.create_publisher(topic.type, topic.name, topic.qos) for topic in MARKERS}
        for topic in DRAWN if server is None else dict.fromkeys((*DRAWN, *RECORDED_TOPICS)):
            unacknowledged = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
            qos = topic.qos if topic.latched else unacknowledged  # the newest messages are enough
            self.create_subscription(topic.type, topic.name, self._receiver(topic), qos, raw=True)

    def draw(self) -> None:
        """Publish the markers of the newest step if there is a new step or a new viewer since the last call."""
        if self._server is not None:
            self._server.welcome()
        audience = {topic: self._count(topic) for topic in MARKERS}
        more = any(audience[topic] > self._audience[topic] for topic in MARKERS)
        self._audience = audience
        if AGENTS not in self._newest or not any(audience.values()) or not (self._fresh or more):
            return
        self._fresh = False
        agents = deserialize_message(self._newest[AGENTS], AGENTS.type)
        table, takeovers = AgentTable.of_message(agents), self._of_run(TAKEOVERS, agents.run_id)
        if audience[MARKERS_AGENTS]:
            self._publish(MARKERS_AGENTS, table.step, self._agents.draw(table, modes_off_log(takeovers)))
        if audience[MARKERS_FORECASTS]:
            self._publish(MARKERS_FORECASTS, table.step, self._forecasts.draw(self._of_run(FORECASTS, agents.run_id)))
        if audience[MARKERS_CONFLICTS]:
            self._publish(MARKERS_CONFLICTS, table.step, self._conflicts.draw(takeovers, table))

    def _receiver(self, topic: Topic) -> Callable[[bytes], None]:
        drawn = topic in DRAWN
        ours = topic not in FOREIGN and (topic == CLOCK or "header" in topic.type.get_fields_and_field_types())

        def receive(data: bytes) -> None:
            if drawn:
                self._newest[topic] = data
                self._fresh = True
            if self._server is not None:
                stamp_ns = cdr.stamp_ns(data) if ours else self._time_ns
                if topic == CLOCK:
                    self._time_ns = stamp_ns
                    self._server.time(stamp_ns)
                self._server.send(topic.name, data, stamp_ns)

        return receive

    def _of_run(self, topic: Topic, run_id: str) -> Any:
        """Returns the newest message of `topic`; an empty one if that is of another run, or there is none."""
        if topic in self._newest:
            message = deserialize_message(self._newest[topic], topic.type)
            if message.run_id == run_id:
                return message
        return topic.type()

    def _count(self, topic: Topic) -> int:
        """Returns the number of viewers of a topic."""
        return int(self._outlets[topic].get_subscription_count()) + (
            0 if self._server is None else self._server.wants(topic.name)
        )

    def _publish(self, topic: Topic, step: int, markers: Any) -> None:
        data = serialize_message(markers)
        self._outlets[topic].publish(data)
        if self._server is not None:
            self._server.send(topic.name, data, step * STEP_NS)


def live(ros_arguments: Sequence[str], rate: float, server_at: tuple[str, int, Collection[str]] | None) -> None:
    """Draw `rate` times a second until Ctrl-C; serve Foxglove at a host and port, if given."""
    sys.argv[1:] = ros_arguments  # read by rclpy's initialisation
    with process(interrupted=0):
        os.nice(NICENESS)
        topics = (topic.described for topic in (*RECORDED_TOPICS, *MARKERS))
        server = LiveServer(topics, *server_at) if server_at else None
        node = LiveNode(server)
        if server is not None:
            node.get_logger().info(f"Foxglove: open a connection to {server.url}")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        due = 0.0
        try:
            while True:
                serve(executor, max(0.0, due - time.monotonic()))
                if time.monotonic() >= due:
                    node.draw()
                    due = time.monotonic() + 1.0 / rate
        finally:
            if server is not None:
                server.close()
