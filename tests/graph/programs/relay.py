"""Stands amid topics and hands messages on as a bad network would: not at all, twice, older ones again, late.

Who publishes is remapped to publish below BEFORE; whoever listens hears what this node lets through. What it does
depends on the step of a message and on how often that step has come, not on any clock; each deed is a line on stdout.
"""

import argparse
import contextlib
import time
from collections import Counter
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from litsim_sim.launch.middleware import use_middleware_settings
from litsim_sim.nodes.recorder import step_of
from litsim_sim.ros.topics import AGENTS, CONTROLS, EGO_CONTROL, FORECASTS, TAKEOVERS, Topic

BEFORE = "/before"
TOPICS = (AGENTS, FORECASTS, TAKEOVERS, CONTROLS, EGO_CONTROL)
LATE_S = 0.2  # [s]


class Relay(Node):
    def __init__(self, topics: tuple[Topic, ...]) -> None:
        super().__init__("relay")
        self.seen = Counter[tuple[Topic, int]]()
        self.older: dict[Topic, bytes] = {}
        for topic in topics:
            publisher = self.create_publisher(topic.type, topic.name, topic.qos)
            place = TOPICS.index(topic)
            self.create_subscription(
                topic.type, BEFORE + topic.name, self.hand_on(topic, place, publisher.publish), topic.qos, raw=True
            )

    def hand_on(self, topic: Topic, place: int, publish: Callable[[bytes], None]) -> Callable[[bytes], None]:
        def receive(data: bytes) -> None:
            step = step_of(topic, data)
            self.seen[topic, step] += 1
            first = self.seen[topic, step] == 1
            if first and step == 6 + place:
                print(f"lost {topic.name}", flush=True)
                return
            if first and step % 8 == 3:
                print(f"late {topic.name}", flush=True)
                time.sleep(LATE_S)
            publish(data)
            if first and step % 8 == 4:
                print(f"twice {topic.name}", flush=True)
                publish(data)
            if first and step % 8 == 5:
                print(f"older {topic.name}", flush=True)
                publish(self.older[topic])
            self.older[topic] = data

        return receive


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("topics", nargs="+", choices=[topic.name for topic in TOPICS])
    options = parser.parse_args()
    use_middleware_settings("relay")
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):  # whichever of both hears it first
        rclpy.spin(Relay(tuple(topic for topic in TOPICS if topic.name in options.topics)))


if __name__ == "__main__":
    main()
