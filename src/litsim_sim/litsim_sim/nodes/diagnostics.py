"""Diagnostics of the bridge on ``/diagnostics``: start, end and faults of a run, for driving systems."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from litsim_sim.ego_port.port import EgoPort, Level
from litsim_sim.ros import messages
from litsim_sim.ros.endpoints import publisher_on
from litsim_sim.ros.topics import DIAGNOSTICS

BRIDGE_NAME = "litsim: bridge"
PORT_NAME = "litsim: ego port"
RUNNING, FINISHED, FAILED = "RUNNING", "FINISHED", "FAILED"
EVERY = 10  # [steps] period of messages without news


class Diagnostics:
    """Publishes the state of a run, and the remarks of its ego port."""

    def __init__(self, node: Node, run_id: str, total_steps: int, port: EgoPort) -> None:
        self._node, self._run_id, self._total, self._port = node, run_id, total_steps, port
        self._publisher = publisher_on(node, DIAGNOSTICS)

    def step(self, step: int) -> None:
        """Publish periodically that the run is active."""
        if step % EVERY == 0:
            self.say(step, RUNNING)

    def remarks(self, step: int) -> None:
        """Publish the port's new remarks, and log them."""
        for remark in self._port.remarks:
            self.say(step, RUNNING, remark.level, remark.text)
            if remark.level == Level.OK:  # rclpy allows one severity per call site
                self._node.get_logger().info(remark.text)
            else:
                self._node.get_logger().warning(remark.text)
        self._port.remarks.clear()

    def say(self, step: int, state: str, level: Level = Level.OK, text: str = "") -> None:
        """Publish the status of the bridge and of the ego port.

        `level` and `text` are those of the ego port while `state` is RUNNING; afterwards `text` is the bridge's.
        """
        port = self._port
        on = state == RUNNING
        bridge = DiagnosticStatus(
            level=bytes([Level.ERROR if state == FAILED else Level.OK]),
            name=BRIDGE_NAME,
            message=state.lower() if on or not text else text,
            hardware_id=self._run_id,
            values=_values({"run_id": self._run_id, "step": step, "total_steps": self._total, "state": state}),
        )
        ego = DiagnosticStatus(
            level=bytes([level if on else Level.OK]),
            name=PORT_NAME,
            message=text if on else "",
            hardware_id=self._run_id,
            values=_values({"interface": port.interface or "", **dict(sorted(port.counts.items()))}),
        )
        self._publisher.publish(DiagnosticArray(header=messages.header(max(0, step)), status=[bridge, ego]))


def _values(values: dict[str, object]) -> list[KeyValue]:
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]
