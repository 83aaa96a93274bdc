"""Topic names and their QoS: the one place where they are written down.

All topics are RELIABLE. Those of the loop are VOLATILE with a depth that outlasts the window by which the bridge
may run ahead of the recorder; run information, route and lanes are latched (TRANSIENT_LOCAL).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from litsim_msgs.msg import AgentStates, Controls, EgoControl, Hello, JointForecast, RunInfo, StageStatus, Takeovers
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from litsim_sim.ego_port.answer import INPUTS, Interface

RECORDER_WINDOW = 50
"""Steps by which the bridge may be ahead of what the recorder has confirmed."""


@dataclass(frozen=True)
class Topic:
    """A topic of the graph.

    Attributes:
        name: absolute name.
        type: message class.
        latched: late subscribers get the last message.
        per_step: while a run is on, it holds one message for every step.
    """

    name: str
    type: Any
    latched: bool = False
    per_step: bool = False

    @property
    def qos(self) -> QoSProfile:
        """QoS that publishers offer and subscriptions request."""
        return QoSProfile(
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE,
            history=HistoryPolicy.KEEP_LAST,
            depth=1 if self.latched else 2 * RECORDER_WINDOW,
        )


RUN_INFO = Topic("/litsim/run_info", RunInfo, latched=True)
HELLO = Topic("/litsim/hello", Hello)
STATUS = Topic("/litsim/status", StageStatus)
RECORDED = Topic("/litsim/recorded", StageStatus)
CLOCK = Topic("/clock", Clock, per_step=True)
AGENTS = Topic("/litsim/agents", AgentStates, per_step=True)
EGO_STATE = Topic("/litsim/ego/state", Odometry, per_step=True)
EGO_ROUTE = Topic("/litsim/ego/route", Path, latched=True)
FORECASTS = Topic("/litsim/forecasts", JointForecast, per_step=True)
TAKEOVERS = Topic("/litsim/takeovers", Takeovers, per_step=True)
CONTROLS = Topic("/litsim/controls", Controls, per_step=True)
EGO_CONTROL = Topic(INPUTS[Interface.CONTROL], EgoControl, per_step=True)
TIMING = Topic("/litsim/timing", StageStatus)

OBJECTS = Topic("/litsim/objects", PointCloud2, per_step=True)
LANES = Topic("/litsim/lanes", MarkerArray, latched=True)
EGO_TWIST = Topic(INPUTS[Interface.TWIST], TwistStamped)
EGO_TRAJECTORY = Topic(INPUTS[Interface.TRAJECTORY], Path)
EGO_APPLIED = Topic("/litsim/ego/applied", EgoControl, per_step=True)
DIAGNOSTICS = Topic("/diagnostics", DiagnosticArray)
MARKERS_AGENTS = Topic("/litsim/markers/agents", MarkerArray)
MARKERS_FORECASTS = Topic("/litsim/markers/forecasts", MarkerArray)
MARKERS_CONFLICTS = Topic("/litsim/markers/conflicts", MarkerArray)
MARKERS = (MARKERS_AGENTS, MARKERS_FORECASTS, MARKERS_CONFLICTS)
"""What the live view publishes; it is never recorded."""

EGO_INPUTS = {
    Interface.CONTROL: EGO_CONTROL,
    Interface.TWIST: EGO_TWIST,
    Interface.TRAJECTORY: EGO_TRAJECTORY,
}
"""Where an external ego may answer."""

FOREIGN = (EGO_CONTROL, EGO_TWIST, EGO_TRAJECTORY, DIAGNOSTICS)
"""Topics that others than LitSim publish as well: nothing is to be taken for granted of what comes on them."""

RECORDED_TOPICS = (
    RUN_INFO,
    DIAGNOSTICS,
    STATUS,
    CLOCK,
    AGENTS,
    EGO_STATE,
    EGO_ROUTE,
    LANES,
    FORECASTS,
    TAKEOVERS,
    CONTROLS,
    EGO_CONTROL,
    EGO_TWIST,
    EGO_TRAJECTORY,
    EGO_APPLIED,
    TIMING,
)
"""What the recorder writes; within a step in this order."""
