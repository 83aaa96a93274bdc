"""Stages that share a process: what comes for several of them is read once, and what one answers is handed to the next.

As with the components of rclcpp, topics, QoS and what is published are those of stages that have a process each. But
nobody waits for a message between two of them: they publish once the last of them has answered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from litsim_msgs.msg import RunInfo
from rclpy.node import Node

from litsim_sim.ros.endpoints import subscribe
from litsim_sim.ros.topics import RUN_INFO, Topic
from litsim_sim.scenario.scenario import Scenario

Read = Callable[[Any], Any]
"""What a stage's core is given of a message; it is called as soon as the message is there, while others work."""

Receive = Callable[[str, int, Callable[[], Any]], None]
"""Takes, of a run and a step, what its third argument reads, or leaves it unread."""


class Company:
    """The stages of one process, which join it one after the other; who waits for another is after that one."""

    def __init__(self) -> None:
        self._answered: set[Topic] = set()  # by a stage of this process
        self._listeners: dict[Topic, list[tuple[Read, Receive]]] = {}
        self._afterwards: list[Callable[[], None]] = []
        self._serving = False
        self._scenario: tuple[str, Scenario] | None = None

    def listen(self, node: Node, topic: Topic, read: Read, receive: Receive) -> None:
        """Have `receive` called with what comes on `topic`: from a stage of this company, else to `node` over DDS."""
        if topic not in self._answered and topic not in self._listeners:
            subscribe(node, topic, lambda message: self._deliver(topic, message))
        self._listeners.setdefault(topic, []).append((read, receive))

    def join(self, outputs: Iterable[Topic]) -> None:
        """Take in a stage that answers on `outputs`."""
        self._answered.update(outputs)

    def waits_for(self, outputs: Iterable[Topic]) -> bool:
        """Whether a stage of this company listens to one of `outputs`, on which another one answers."""
        return any(topic in self._answered and topic in self._listeners for topic in outputs)

    def hand_on(self, answers: Mapping[Topic, Any], run_id: str, step: int) -> None:
        """Hand what a stage has answered, by topic, to those of this company that listen."""
        for topic, answer in answers.items():
            for _, receive in self._listeners.get(topic, ()):
                receive(run_id, step, partial(_same, answer))

    def afterwards(self, do: Callable[[], None]) -> None:
        """Do what nobody waits for once the message at hand has been served."""
        self._afterwards.append(do)
        if not self._serving:
            self._catch_up()

    def scenario(self, info: RunInfo) -> Scenario:
        """The scenario of a run, which is read once.

        Raises:
            InputError: it cannot be read.
        """
        if self._scenario is None or self._scenario[0] != info.run_id:
            made = Scenario.from_yaml(info.scenario_yaml, f"{RUN_INFO.name} of run {info.run_id}")
            self._scenario = (info.run_id, made)
        return self._scenario[1]

    def _deliver(self, topic: Topic, message: Any) -> None:
        """Give a message to all who listen; each way to read it is gone once."""
        known: dict[Read, Any] = {}

        def reader(read: Read) -> Any:
            if read not in known:
                known[read] = read(message)
            return known[read]

        self._serving = True
        try:
            for read, receive in self._listeners[topic]:
                receive(message.run_id, message.step, partial(reader, read))
        finally:
            self._serving = False
            self._catch_up()

    def _catch_up(self) -> None:
        while self._afterwards:
            self._afterwards.pop(0)()


def _same(answer: Any) -> Any:
    return answer
