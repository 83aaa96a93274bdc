"""Topics with their types and QoS; names are defined in :mod:`litsim_sim.core.topic_names`.

All topics are RELIABLE. Those of the loop are VOLATILE with a depth that outlasts the window by which the bridge
may run ahead of the recorder; run information, mission and lanes are latched (TRANSIENT_LOCAL).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped, TwistStamped
from litsim_msgs.msg import (
    AgentStates,
    Controls,
    EgoControl,
    Hello,
    JointForecast,
    RunInfo,
    SignalMap,
    SignalStates,
    StageStatus,
    Takeovers,
)
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from litsim_sim.core import topic_names
from litsim_sim.core.lockstep import RECORDER_WINDOW
from litsim_sim.core.topic_names import Interface
from litsim_sim.record.bag import BagTopic, qos_yaml
from litsim_sim.ros.definitions import definition, type_hash, type_name

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # stock ROS 2 has it, the wheels do not
    TFMessage = None


@dataclass(frozen=True)
class Topic:
    """A topic of the graph.

    Attributes:
        name: absolute name.
        type: message class.
        latched: late subscribers get the last message.
    """

    name: str
    type: Any
    latched: bool = False

    @property
    def qos(self) -> QoSProfile:
        """QoS that publishers offer and subscriptions request."""
        return QoSProfile(
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE,
            history=HistoryPolicy.KEEP_LAST,
            depth=1 if self.latched else 2 * RECORDER_WINDOW,
        )

    @property
    def described(self) -> BagTopic:
        """The topic as a bag has it: with its definition, offered QoS and type hash."""
        name, durability = type_name(self.type), "transient_local" if self.latched else "volatile"
        return BagTopic(self.name, name, definition(name), qos_yaml(self.qos.depth, durability), type_hash(name))


RUN_INFO = Topic(topic_names.RUN_INFO, RunInfo, latched=True)
HELLO = Topic(topic_names.HELLO, Hello)
STATUS = Topic(topic_names.STATUS, StageStatus)
RECORDED = Topic(topic_names.RECORDED, StageStatus)
CLOCK = Topic(topic_names.CLOCK, Clock)
AGENTS = Topic(topic_names.AGENTS, AgentStates)
EGO_STATE = Topic(topic_names.EGO_STATE, Odometry)
EGO_ROUTE = Topic(topic_names.EGO_ROUTE, Path, latched=True)
EGO_GOAL = Topic(topic_names.EGO_GOAL, PoseStamped, latched=True)
EGO_VEHICLE = Topic(topic_names.EGO_VEHICLE, DiagnosticArray, latched=True)
EGO_FOOTPRINT = Topic(topic_names.EGO_FOOTPRINT, PolygonStamped, latched=True)
FORECASTS = Topic(topic_names.FORECASTS, JointForecast)
TAKEOVERS = Topic(topic_names.TAKEOVERS, Takeovers)
CONTROLS = Topic(topic_names.CONTROLS, Controls)
EGO_CONTROL = Topic(topic_names.EGO_CONTROL, EgoControl)
TIMING = Topic(topic_names.TIMING, StageStatus)

TF = Topic(topic_names.TF, TFMessage)
TF_STATIC = Topic(topic_names.TF_STATIC, TFMessage, latched=True)
FRAMES = (TF, TF_STATIC) if TFMessage else ()
"""Topics of the ego's frames; none where their type is not installed."""

OBJECTS = Topic(topic_names.OBJECTS, PointCloud2)
LANES = Topic(topic_names.LANES, MarkerArray, latched=True)
LANE_TABLE = Topic(topic_names.LANE_TABLE, PointCloud2, latched=True)
LANE_LINKS = Topic(topic_names.LANE_LINKS, PointCloud2, latched=True)
SIGNALS = Topic(topic_names.SIGNALS, SignalStates)
SIGNAL_MAP = Topic(topic_names.SIGNAL_MAP, SignalMap, latched=True)
LIGHTS = Topic(topic_names.LIGHTS, PointCloud2)
LIGHT_MARKERS = Topic(topic_names.LIGHT_MARKERS, MarkerArray)
EGO_TWIST = Topic(topic_names.EGO_TWIST, TwistStamped)
EGO_TRAJECTORY = Topic(topic_names.EGO_TRAJECTORY, Path)
EGO_APPLIED = Topic(topic_names.EGO_APPLIED, EgoControl)
DIAGNOSTICS = Topic(topic_names.DIAGNOSTICS, DiagnosticArray)
MARKERS_AGENTS = Topic(topic_names.MARKERS_AGENTS, MarkerArray)
MARKERS_FORECASTS = Topic(topic_names.MARKERS_FORECASTS, MarkerArray)
MARKERS_CONFLICTS = Topic(topic_names.MARKERS_CONFLICTS, MarkerArray)
MARKERS = (MARKERS_AGENTS, MARKERS_FORECASTS, MARKERS_CONFLICTS)
"""Topics that the live view publishes; never recorded."""

EGO_INPUTS = {
    Interface.CONTROL: EGO_CONTROL,
    Interface.TWIST: EGO_TWIST,
    Interface.TRAJECTORY: EGO_TRAJECTORY,
}
"""Topics on which an external ego may answer."""

EGO_FEEDS = (
    EGO_STATE,
    OBJECTS,
    EGO_ROUTE,
    EGO_GOAL,
    EGO_VEHICLE,
    EGO_FOOTPRINT,
    LANES,
    LANE_TABLE,
    LANE_LINKS,
    LIGHTS,
    LIGHT_MARKERS,
    SIGNALS,
    SIGNAL_MAP,
    CLOCK,
    DIAGNOSTICS,
    AGENTS,
    RUN_INFO,
    *FRAMES,
)
"""Topics for an external ego to read."""

FOREIGN = (EGO_CONTROL, EGO_TWIST, EGO_TRAJECTORY, DIAGNOSTICS)
"""Topics that foreign nodes publish on as well: their messages must be checked."""

RECORDED_TOPICS = (
    RUN_INFO,
    DIAGNOSTICS,
    STATUS,
    CLOCK,
    AGENTS,
    EGO_STATE,
    EGO_ROUTE,
    EGO_GOAL,
    LANES,
    LANE_TABLE,
    LANE_LINKS,
    SIGNAL_MAP,
    SIGNALS,
    FORECASTS,
    TAKEOVERS,
    CONTROLS,
    EGO_CONTROL,
    EGO_TWIST,
    EGO_TRAJECTORY,
    EGO_APPLIED,
    TIMING,
)
"""Topics that the recorder writes, within a step in this order."""
