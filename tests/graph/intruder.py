"""A node of nobody's that answers every step on one of the graph's internal topics: its name is the argument.

Given a second argument, it also drives the ego, which goes on as it is: a stack that reaches for more than its part.
"""

from __future__ import annotations

import sys

import rclpy
from litsim_msgs.msg import AgentStates, EgoControl
from rclpy.node import Node

from litsim_sim.launch.middleware import use_middleware_settings
from litsim_sim.ros import topics
from litsim_sim.ros.topics import AGENTS, CLOCK, EGO_CONTROL, Topic


class Intruder(Node):
    def __init__(self, topic: Topic, *, drives: bool) -> None:
        super().__init__("intruder")
        self.topic, self.drives = topic, drives
        self.to = {t: self.create_publisher(t.type, t.name, t.qos) for t in {topic, *((EGO_CONTROL,) * drives)}}
        self.create_subscription(AgentStates, AGENTS.name, self.answer, AGENTS.qos)

    def answer(self, agents: AgentStates) -> None:
        usual = {"header": agents.header, "run_id": agents.run_id, "step": agents.step}
        given = usual.keys() & self.topic.type.get_fields_and_field_types()
        if self.topic not in (AGENTS, CLOCK):  # which it would answer again
            self.to[self.topic].publish(self.topic.type(**{name: usual[name] for name in given}))
        if self.drives:
            self.to[EGO_CONTROL].publish(EgoControl(**usual))


def main() -> None:
    (topic,) = {topic for topic in vars(topics).values() if isinstance(topic, Topic) and topic.name == sys.argv[1]}
    use_middleware_settings("intruder")
    rclpy.init()
    rclpy.spin(Intruder(topic, drives=len(sys.argv) > 2))


if __name__ == "__main__":
    main()
