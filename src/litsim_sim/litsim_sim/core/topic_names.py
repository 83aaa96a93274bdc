"""Names of the topics, for nodes and for readers of bags without ROS.

Types and QoS are defined in :mod:`litsim_sim.ros.topics`.
"""

from __future__ import annotations

from enum import StrEnum

RUN_INFO = "/litsim/run_info"
HELLO = "/litsim/hello"
STATUS = "/litsim/status"
RECORDED = "/litsim/recorded"
TIMING = "/litsim/timing"

CLOCK = "/clock"
AGENTS = "/litsim/agents"
OBJECTS = "/litsim/objects"
LANES = "/litsim/lanes"
LANE_TABLE = "/litsim/lanes/table"
LANE_LINKS = "/litsim/lanes/links"
SIGNALS = "/litsim/signals"
SIGNAL_MAP = "/litsim/signals/map"
LIGHTS = "/litsim/lights"
LIGHT_MARKERS = "/litsim/lights/markers"
EGO_STATE = "/litsim/ego/state"
EGO_ROUTE = "/litsim/ego/route"
EGO_GOAL = "/litsim/ego/goal"
EGO_VEHICLE = "/litsim/ego/vehicle"
EGO_FOOTPRINT = "/litsim/ego/footprint"
TF = "/tf"
TF_STATIC = "/tf_static"

FORECASTS = "/litsim/forecasts"
TAKEOVERS = "/litsim/takeovers"
CONTROLS = "/litsim/controls"

EGO_CONTROL = "/litsim/ego/control"
EGO_TWIST = "/litsim/ego/twist"
EGO_TRAJECTORY = "/litsim/ego/trajectory"
EGO_APPLIED = "/litsim/ego/applied"

DIAGNOSTICS = "/diagnostics"
MARKERS_AGENTS = "/litsim/markers/agents"
MARKERS_FORECASTS = "/litsim/markers/forecasts"
MARKERS_CONFLICTS = "/litsim/markers/conflicts"


class Interface(StrEnum):
    """Type of a driving system's answers on the ego port."""

    CONTROL = "control"
    TWIST = "twist"
    TRAJECTORY = "trajectory"


EGO_INPUTS = {
    Interface.CONTROL: EGO_CONTROL,
    Interface.TWIST: EGO_TWIST,
    Interface.TRAJECTORY: EGO_TRAJECTORY,
}
"""Topic of each interface."""
AUTO = "auto"
INTERFACES = (AUTO, *Interface)
"""Choices for the interface; `auto` is that of the first message."""
