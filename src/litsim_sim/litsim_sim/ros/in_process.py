"""Stages that share a process: inputs are read once for all of them, and answers are passed on within the process.

As with components of rclcpp, topics, QoS and published messages are those of stages in separate processes. But no stage
waits for a message of another one of the process: all publish after the last of them has answered.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from litsim_msgs.msg import RunInfo
from rclpy.node import Node

from litsim_sim.ros.endpoints import subscribe
from litsim_sim.ros.topics import RUN_INFO, Topic
from litsim_sim.scenario.scenario import Scenario

Read = Callable[[Any], Any]
"""Converts a message to the input of a stage's core; called as soon as the message is there."""

Receive = Callable[[str, int, Callable[[], Any]], None]
"""Takes run id, step, and a function that reads the message, which is called only if needed."""


class InProcessTransport:
    """The stages of one process, in the order in which they join: a stage joins after those that it waits for."""

    def __init__(self, loaded: Scenario | None = None) -> None:
        """Make it; `loaded` is the scenario of a run to come, which is not read again then."""
        self._loaded = loaded
        self._answered: set[Topic] = set()  # topics answered by a stage of this process
        self._listeners: dict[Topic, list[tuple[Read, Receive]]] = {}
        self._deferred: list[Callable[[], None]] = []
        self._serving = False
        self._scenario: tuple[str, Scenario] | None = None

    def listen(self, node: Node, topic: Topic, read: Read, receive: Receive) -> None:
        """Call `receive` for messages on `topic`: from a stage of this process if one answers on it, else over DDS."""
        if topic not in self._answered and topic not in self._listeners:
            subscribe(node, topic, lambda message: self._deliver(topic, message))
        self._listeners.setdefault(topic, []).append((read, receive))

    def join(self, output: Topic) -> None:
        """Add a stage that answers on `output`."""
        self._answered.add(output)

    def has_listener(self, output: Topic) -> bool:
        """Returns whether a stage of this process, other than that which answers on it, listens to `output`."""
        return output in self._listeners

    def publish(self, output: Topic, answer: Any, run_id: str, step: int) -> None:
        """Pass the answer of a stage to the stages of this process that listen."""
        for _, receive in self._listeners[output]:
            receive(run_id, step, lambda: answer)

    def defer(self, do: Callable[[], None]) -> None:
        """Call `do` after the current message has been served, for work that no node waits for."""
        self._deferred.append(do)
        if not self._serving:
            self._catch_up()

    def scenario(self, info: RunInfo) -> Scenario:
        """Returns the scenario of a run, read once; raises InputError if it cannot be read."""
        if self._scenario is None or self._scenario[0] != info.run_id:
            scenario = self._loaded
            if scenario is None or scenario.to_yaml() != info.scenario_yaml:
                scenario = Scenario.from_yaml(info.scenario_yaml, f"{RUN_INFO.name} of run {info.run_id}")
            self._scenario = (info.run_id, scenario)
        return self._scenario[1]

    def _deliver(self, topic: Topic, message: Any) -> None:
        """Deliver a message to all listeners; each conversion of it is done once."""
        kept: dict[Read, Any] = {}

        def reader(read: Read) -> Any:
            if read not in kept:
                kept[read] = read(message)
            return kept[read]

        self._serving = True
        try:
            for read, receive in self._listeners[topic]:
                receive(message.run_id, message.step, partial(reader, read))
        finally:
            self._serving = False
            self._catch_up()

    def _catch_up(self) -> None:
        while self._deferred:
            self._deferred.pop(0)()
