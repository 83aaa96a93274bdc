"""The ego as Autoware reads it: frame, status of the vehicle and pose, at each step and in real time between steps."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import inf

from autoware_vehicle_msgs.msg import (
    ControlModeReport,
    GearReport,
    HazardLightsReport,
    SteeringReport,
    TurnIndicatorsReport,
    VelocityReport,
)
from geometry_msgs.msg import AccelWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from litsim_autoware.messages import vehicle
from litsim_autoware.messages.output import Output
from litsim_autoware.messages.vehicle import RearAxle
from litsim_autoware.node.vehicle_state import VehicleState
from litsim_sim.core.scene import STEP_NS
from litsim_sim.core.vehicle import VehicleGeometry
from litsim_sim.ros.endpoints import publisher_on
from litsim_sim.ros.frames import fixed_frames
from litsim_sim.ros.topics import FRAMES, TF, TF_STATIC

STATE_S = 0.02  # [s] period of the ego's state between steps, in real time and before the run
STATUS_TOPICS = {
    "velocity": ("/vehicle/status/velocity_status", VelocityReport),
    "steering": ("/vehicle/status/steering_status", SteeringReport),
    "gear": ("/vehicle/status/gear_status", GearReport),
    "control_mode": ("/vehicle/status/control_mode", ControlModeReport),
    "turn_indicators": ("/vehicle/status/turn_indicators_status", TurnIndicatorsReport),
    "hazard_lights": ("/vehicle/status/hazard_lights_status", HazardLightsReport),
    "acceleration": ("/localization/acceleration", AccelWithCovarianceStamped),
    "odometry": ("/localization/kinematic_state", Odometry),
}
"""Topics about the ego, in the order in which they are published: its pose is the last message of a step."""


class EgoFeed:
    """Publishes the ego.

    Attributes:
        motion: of its rear axle at the newest step that is published; None before the run, and once it has left.
    """

    def __init__(self, node: Node, state: VehicleState) -> None:
        """Make its publishers; `state` is what is reported beside the motion."""
        self._state = state
        self._frames = Output(node, TF.type, TF.name if FRAMES else None, TF.qos)
        self._fixed_frames = publisher_on(node, TF_STATIC) if FRAMES else None
        self._status = {name: Output(node, kind, topic) for name, (topic, kind) in STATUS_TOPICS.items()}
        self.motion: RearAxle | None = None
        self._stamp_ns, self._began = 0, 0.0  # of the step; [s] of the performance counter
        self._states = 0  # published since then
        self._steering = 0.0

    def begin_run(self, geometry: VehicleGeometry) -> None:
        """Publish the frames that are fixed to an ego of these sizes."""
        if self._fixed_frames is not None:
            self._fixed_frames.publish(fixed_frames(geometry.rear_axle_to_centre))

    def begin_step(self, motion: RearAxle | None, stamp_ns: int, began: float) -> None:
        """Take the ego's motion at a step, which began at `began` of the performance counter [s]."""
        self.motion, self._stamp_ns, self._began, self._states = motion, stamp_ns, began, 0

    def show_step(self, motion: RearAxle, wheelbase: float) -> None:
        """Publish the ego at the step that has begun, with the steering angle of its motion [m]."""
        angle = motion.steering(wheelbase)
        self._steering = self._steering if angle is None else angle
        self.show(motion, self._stamp_ns)

    def show_between_steps(self, now: float) -> float:
        """Publish the state that is due at `now` of the performance counter [s]; return the time until the next one."""
        if self.motion is None:
            return inf
        due = self._began + (self._states + 1) * STATE_S
        if now >= due and self._states < STEP_NS * 1e-9 / STATE_S - 1:
            self._states += 1
            after = self._states * STATE_S
            self.show(self.motion.after(after), self._stamp_ns + round(after * 1e9))
        return max(0.0, due - now)

    def show(self, motion: RearAxle, stamp_ns: int) -> None:
        """Publish the ego: its frame, the status of the vehicle, its pose."""
        self._frames.publish(partial(motion.transform, stamp_ns))
        write: dict[str, Callable[[int], bytes]] = {
            "velocity": motion.velocity,
            "steering": partial(vehicle.steering_report, self._steering),
            "acceleration": motion.accel,
            "odometry": motion.odometry,
        }
        write |= {name: partial(vehicle.report, value) for name, value in self._state.reports.items()}
        for name, output in self._status.items():
            output.publish(partial(write[name], stamp_ns))
