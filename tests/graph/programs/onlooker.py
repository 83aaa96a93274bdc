"""Looks on until a graph has exactly the endpoints that a file tells of, and one more node publishes a topic.

Says which endpoints there are, by then or when its time is over.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node

from litsim_eval.check_ads.bystander import Bystander
from litsim_eval.check_ads.trace import Evidence
from litsim_sim.launch.middleware import use_middleware_settings
from litsim_sim.scenario.scenario import Scenario

KINDS = {
    "publish": Node.get_publisher_names_and_types_by_node,
    "subscribe": Node.get_subscriber_names_and_types_by_node,
    "reply": Node.get_service_names_and_types_by_node,
    "request": Node.get_client_names_and_types_by_node,
}


def endpoints(node: Node) -> dict[str, dict[str, list[str]]]:
    """By full name of a node, the names of its endpoints of each kind."""
    found = {}
    for name, namespace in node.get_node_names_and_namespaces():
        if name == node.get_name():
            continue
        try:
            of_node = {kind: sorted(n for n, _ in ask(node, name, namespace)) for kind, ask in KINDS.items()}
        except rclpy._rclpy_pybind11.NodeNameNonExistentError:  # it is known by name alone so far, or has just ended
            continue
        found[f"{namespace.rstrip('/')}/{name}"] = of_node
    return found


def main() -> None:
    expected: dict[str, Any] = json.loads(Path(sys.argv[1]).read_text())
    until = time.monotonic() + float(sys.argv[2])
    another, topic = sys.argv[3:]
    use_middleware_settings("onlooker")
    rclpy.init()
    node = Node("onlooker", start_parameter_services=False)
    with Bystander(node.context.get_domain_id(), {}, Evidence(Scenario.load("demo"), 0.0)):
        while True:
            found = endpoints(node)
            as_told = all(found.get(name) == its for name, its in expected.items())
            if (as_told and topic in found.get(another, {}).get("publish", ())) or time.monotonic() > until:
                break
            rclpy.spin_once(node, timeout_sec=0.2)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
