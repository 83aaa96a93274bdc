"""The parameters of the bridge: what is run, and how it is run."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

from rclpy.node import Node

from litsim_sim.core.errors import InputError
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.vehicle import VEHICLE_FIELDS
from litsim_sim.ego_port.answer import INTERFACES
from litsim_sim.ros.stage import check_parameters
from litsim_sim.scenario.run_info import EGOS, POLICIES, RunPlan
from litsim_sim.scenario.scenario import Scenario

OF_THE_SCENARIO = -1  # value of a parameter that leaves it to the scenario


@dataclass(frozen=True)
class BridgeOptions:
    """How a run is run; see ``config/bridge.yaml``.

    Attributes:
        plan: what is run.
        mode: lockstep or realtime.
        on_missing: stop or hold, where an answer does not come in lock-step.
        on_invalid: stop or hold, where an answer of the ego cannot be used.
        ego_interface: one of :data:`litsim_sim.ego_port.answer.INTERFACES`, for an external ego.
        answer_timeout_s, handshake_timeout_s, external_timeout_s: [s].
        progress: bar, lines or none.
    """

    plan: RunPlan
    mode: str
    on_missing: str
    on_invalid: str
    ego_interface: str
    answer_timeout_s: float
    handshake_timeout_s: float
    external_timeout_s: float
    progress: str


_CHOICES: dict[str, tuple[str, ...]] = {
    "mode": ("lockstep", "realtime"),
    "on_missing": ("stop", "hold"),
    "on_invalid": ("stop", "hold"),
    "ego_interface": INTERFACES,
    "progress": ("bar", "lines", "none"),
}
"""The first is the default."""

_TIMES = {"answer_timeout_s": 5.0, "handshake_timeout_s": 20.0, "external_timeout_s": 60.0}
_RUN = {"scenario": "demo", "ego": "idm", "policy": "litsim"}
_NUMBERS = {"ego_id": "ego", "seed": "seed"}


def declare_options(node: Node) -> BridgeOptions:
    """Declare the parameters of the bridge on `node`, and load what they name.

    Raises:
        InputError: a parameter is unknown or out of range, or the scenario cannot be used.
    """
    choices = {name: str(node.declare_parameter(name, allowed[0]).value) for name, allowed in _CHOICES.items()}
    times = {name: float(node.declare_parameter(name, value).value) for name, value in _TIMES.items()}
    run = {name: str(node.declare_parameter(name, value).value) for name, value in _RUN.items()}
    numbers = {name: int(node.declare_parameter(name, OF_THE_SCENARIO).value) for name in _NUMBERS}
    vehicle = {
        name: float(node.declare_parameter(f"vehicle.{name}", float(OF_THE_SCENARIO)).value) for name in VEHICLE_FIELDS
    }
    check_parameters(node)
    for name, allowed in (_CHOICES | {"ego": EGOS, "policy": POLICIES}).items():
        value = (choices | run)[name]
        if value not in allowed:
            raise InputError(f"{BRIDGE}: parameter {name} is {value!r}, expected one of {', '.join(allowed)}")
    for name, seconds in times.items():
        if not 0.0 < seconds < inf:
            raise InputError(f"{BRIDGE}: parameter {name} is {seconds}, expected seconds > 0")
    overrides = {_NUMBERS[name]: value for name, value in numbers.items() if value >= 0}
    own = {name: value for name, value in vehicle.items() if value != OF_THE_SCENARIO}
    scenario = Scenario.load(run["scenario"], **overrides, vehicle=own or None)
    values: dict[str, Any] = choices | times
    return BridgeOptions(RunPlan(scenario, run["ego"], run["policy"]), **values)
