"""A driving stack of somebody else's: it knows the messages, and nothing of LitSim's Python.

Brakes gently on a straight line, in LitSim's frame and units. Options make it fail in the ways that stacks do.
"""

import argparse
import time
from pathlib import Path

import rclpy
from litsim_msgs.msg import AgentStates, EgoControl
from rclpy.node import Node


class ExternalEgo(Node):
    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("my_stack")
        self.options = options
        self.answered = -1
        self.publisher = self.create_publisher(EgoControl, "/litsim/ego/control", 10)
        self.create_subscription(AgentStates, "/litsim/agents", self.on_agents, 100)

    def on_agents(self, agents: AgentStates) -> None:
        options = self.options
        if agents.step in options.skip:
            return
        while agents.step == options.hold_at and not options.until.exists():
            time.sleep(0.02)
        if agents.step in options.late and agents.step != self.answered:
            time.sleep(options.late_by)
        self.answered = agents.step
        answer = EgoControl(header=agents.header, run_id=agents.run_id, step=agents.step)
        answer.acceleration = float("nan") if agents.step == options.nan_at else -1.0
        self.publisher.publish(answer)


def steps(text: str) -> range:
    first, last = (int(part) for part in text.split("-"))
    return range(first, last + 1)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--nan-at", type=int, default=-1)
    parser.add_argument("--skip", type=steps, default=range(0), metavar="FIRST-LAST")
    parser.add_argument("--late", type=steps, default=range(0), metavar="FIRST-LAST")
    parser.add_argument("--late-by", type=float, default=0.15, metavar="S")
    parser.add_argument("--hold-at", type=int, default=-1, help="answer this step once the file --until is there")
    parser.add_argument("--until", type=Path, default=Path("go"), metavar="FILE")
    rclpy.init()
    rclpy.spin(ExternalEgo(parser.parse_args()))


if __name__ == "__main__":
    main()
