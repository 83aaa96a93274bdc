"""Start-up of the stack at a scene that stands still: its services are called, and what it lacks is told for it."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import cos, sin
from typing import Any

from autoware_adapi_v1_msgs.msg import LocalizationInitializationState, OperationModeState
from autoware_adapi_v1_msgs.srv import ChangeOperationMode, ClearRoute, InitializeLocalization, SetRoutePoints
from geometry_msgs.msg import Pose, PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

from litsim_autoware.messages.vehicle import RearAxle
from litsim_autoware.node.announced_run import AnnouncedRun
from litsim_autoware.node.clock import StackClock
from litsim_autoware.stack.profile import TRAJECTORY, Profile
from litsim_autoware.stack.start_up import Call, StartUp
from litsim_sim.core.scene import FloatArray
from litsim_sim.ros import messages

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NOTE_S = 5.0  # [s] period of lines that say what is waited for


class Preparation:
    """Calls the services of the stack before it drives, and publishes for it that it is localised and drives."""

    _start_up: StartUp

    def __init__(self, node: Node, profile: Profile, clock: StackClock) -> None:
        """Make the publishers of the topics that `profile` names; `clock` stamps the requests."""
        self._node, self._profile, self._clock = node, profile, clock
        self._noted = time.monotonic()
        states = {
            profile.initialization_state: LocalizationInitializationState(state=3),
            profile.operation_mode: _autonomous(),
        }
        self._latched = [
            (node.create_publisher(type(message), topic, LATCHED), message)
            for topic, message in states.items()
            if topic
        ]

    def begin_run(self, run: AnnouncedRun, ego: Callable[[], RearAxle | None]) -> None:
        """Begin to call the services, with the mission of `run`; `ego` tells where the ego is."""
        mission, lever = run.mission, run.geometry.rear_axle_to_centre
        goal, *waypoints = (_behind(pose, lever) for pose in [mission.goal, *mission.waypoints(run.scenario.lane_map)])
        self._start_up = StartUp(self._calls(goal, waypoints, ego))
        for publisher, message in self._latched:
            message.stamp = Clock().clock
            publisher.publish(message)

    @property
    def is_done(self) -> bool:
        """Whether all services have succeeded."""
        return self._start_up.done

    def poll(self, now: float) -> None:
        """Go on as far as possible without waiting; `now` is in seconds of any clock."""
        self._start_up.poll(now)

    def note(self) -> None:
        """Say now and then what is waited for."""
        if time.monotonic() > self._noted + NOTE_S:
            self._noted = time.monotonic()
            profile = self._profile
            topic = profile.trajectory if profile.answers == TRAJECTORY else profile.control
            self._node.get_logger().info(f"waiting for {self._start_up.waiting or f'a message on {topic}'}")

    def _calls(self, goal: Pose, waypoints: list[Pose], ego: Callable[[], RearAxle | None]) -> dict[str, Call]:
        def initialize() -> InitializeLocalization.Request:
            pose = PoseWithCovarianceStamped(header=self._header())
            if (motion := ego()) is not None:
                pose.pose.pose = _pose(motion.x, motion.y, motion.yaw)
            return InitializeLocalization.Request(pose=[pose])

        kinds: dict[str, tuple[Any, Callable[[], Any]]] = {
            "initialize": (InitializeLocalization, initialize),
            "clear_route": (ClearRoute, ClearRoute.Request),
            "set_route": (
                SetRoutePoints,
                lambda: SetRoutePoints.Request(header=self._header(), goal=goal, waypoints=waypoints),
            ),
            "engage": (ChangeOperationMode, ChangeOperationMode.Request),
        }
        calls = {}
        for name, (kind, request) in kinds.items():
            if service := getattr(self._profile, name):
                client = self._node.create_client(kind, service)
                calls[name] = Call(service, client.service_is_ready, _caller(client, request))
        return calls

    def _header(self) -> Any:
        """Header at the present time of the stack, in frame map."""
        header = messages.header(0)
        header.stamp.sec, header.stamp.nanosec = divmod(self._clock.waiting_ns, 10**9)
        return header


def _behind(centre: FloatArray, lever: float) -> Pose:
    """The pose of a rear axle, `lever` metres behind the pose (3,) of a box centre [m, m, rad]."""
    x, y, yaw = centre.tolist()
    return _pose(x - lever * cos(yaw), y - lever * sin(yaw), yaw)


def _pose(x: float, y: float, yaw: float) -> Pose:
    """The message of a pose in the plane [m, m, rad]."""
    pose = Pose()
    messages.place_at(pose, x, y, yaw)
    return pose


def _caller(client: Any, request: Callable[[], Any]) -> Callable[[], Any]:
    """A function that calls a service with a new request."""
    return lambda: client.call_async(request())


def _autonomous() -> OperationModeState:
    return OperationModeState(
        mode=OperationModeState.AUTONOMOUS,
        is_autoware_control_enabled=True,
        is_stop_mode_available=True,
        is_autonomous_mode_available=True,
    )
