"""Topic names and their QoS: the one place where they are written down.

All topics are RELIABLE. Those of the loop are VOLATILE with a depth that outlasts the window by which the bridge
may run ahead of the recorder; run information and route are latched (TRANSIENT_LOCAL).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from litsim_msgs.msg import (
    AgentStates,
    Controls,
    EgoControl,
    Hello,
    JointForecast,
    RunInfo,
    StageStatus,
    Takeovers,
)
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

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
EGO_CONTROL = Topic("/litsim/ego/control", EgoControl, per_step=True)
TIMING = Topic("/litsim/timing", StageStatus)

RECORDED_TOPICS = (
    RUN_INFO,
    STATUS,
    CLOCK,
    AGENTS,
    EGO_STATE,
    EGO_ROUTE,
    FORECASTS,
    TAKEOVERS,
    CONTROLS,
    EGO_CONTROL,
    TIMING,
)
"""What the recorder writes; within a step in this order."""
