"""The ego's gear, lights and control mode as the stack commands them, and the stack's minimum-risk state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from autoware_adapi_v1_msgs.msg import MrmState
from autoware_vehicle_msgs.msg import (
    ControlModeReport,
    GearCommand,
    GearReport,
    HazardLightsCommand,
    HazardLightsReport,
    TurnIndicatorsCommand,
    TurnIndicatorsReport,
)
from autoware_vehicle_msgs.srv import ControlModeCommand
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from litsim_autoware.messages.output import QOS
from litsim_autoware.stack.profile import Profile
from litsim_sim.ros import messages
from litsim_sim.ros.endpoints import publisher_on
from litsim_sim.ros.topics import DIAGNOSTICS

COMMANDS = {
    "gear": ("/control/command/gear_cmd", GearCommand),
    "turn_indicators": ("/control/command/turn_indicators_cmd", TurnIndicatorsCommand),
    "hazard_lights": ("/control/command/hazard_lights_cmd", HazardLightsCommand),
}
"""Topics of the stack whose commands are reported back."""
CONTROL_MODE_REQUEST = "/control/control_mode_request"


class VehicleState:
    """Commands of the stack to the vehicle other than its motion; a command of zero counts as no command.

    Attributes:
        reports: values of Autoware's reports, by the name of the status topic.
    """

    def __init__(self, node: Node, profile: Profile) -> None:
        self.reports = {
            "gear": GearReport.DRIVE,
            "control_mode": getattr(ControlModeReport, profile.starts_in.upper()),
            "turn_indicators": TurnIndicatorsReport.DISABLE,
            "hazard_lights": HazardLightsReport.DISABLE,
        }
        self._description, self._mrm_state, self._told = profile.description, MrmState.UNKNOWN, ""
        self._diagnostics = publisher_on(node, DIAGNOSTICS)
        for name, (topic, kind) in COMMANDS.items():
            node.create_subscription(kind, topic, self._command_taker(name), QOS)
        if profile.mrm_state:
            node.create_subscription(MrmState, profile.mrm_state, self._on_mrm_state, QOS)
        node.create_service(ControlModeCommand, CONTROL_MODE_REQUEST, self._on_control_mode)

    def tell(self, step: int) -> None:
        """Tell the state on /diagnostics, which is recorded, where it has changed."""
        values = {**self.reports, "mrm_state": self._mrm_state, "profile": self._description}
        if (text := str(values)) != self._told:
            self._told = text
            pairs = [KeyValue(key=name, value=str(value)) for name, value in values.items()]
            status = DiagnosticStatus(name="litsim: autoware", values=pairs)
            self._diagnostics.publish(DiagnosticArray(header=messages.header(step), status=[status]))

    def _command_taker(self, name: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            self.reports[name] = message.command or self.reports[name]

        return take

    def _on_mrm_state(self, message: MrmState) -> None:
        self._mrm_state = message.state

    def _on_control_mode(
        self, request: ControlModeCommand.Request, response: ControlModeCommand.Response
    ) -> ControlModeCommand.Response:
        self.reports["control_mode"] = request.mode or self.reports["control_mode"]
        response.success = True
        return response
