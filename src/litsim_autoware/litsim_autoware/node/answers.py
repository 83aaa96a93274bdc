"""What Autoware commands or plans, as answers at the ego port."""

from __future__ import annotations

from typing import Any

import numpy as np
from autoware_control_msgs.msg import Control
from autoware_planning_msgs.msg import Trajectory
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.publisher import Publisher

from litsim_autoware.messages import vehicle
from litsim_autoware.messages.output import QOS
from litsim_autoware.node.announced_run import AnnouncedRun
from litsim_autoware.node.clock import StackClock
from litsim_autoware.node.ego_feed import EgoFeed
from litsim_autoware.stack.profile import TRAJECTORY, Profile
from litsim_sim.core.scene import STEP_NS, EgoCommand, FloatArray
from litsim_sim.ros import messages
from litsim_sim.ros.cdr import stamp_ns
from litsim_sim.ros.endpoints import publisher_on
from litsim_sim.ros.topics import EGO_CONTROL, EGO_TRAJECTORY

HORIZON_S = 8.0  # [s] of a trajectory that is passed on


class Answers:
    """Answers every step of a run, by the stack's control commands or by its trajectory.

    Planner and controller are processes of their own. Which trajectory a command follows would depend on the load of
    the machine: in lock-step, the command that answers a step is therefore the next but one after its trajectory.

    Attributes:
        newest: step that the bridge has published last; None before.
        answered: newest step that was answered; -1 before.
        is_heard: whether the stack has answered since it is ready.
    """

    _run: AnnouncedRun
    _answer: tuple[Publisher, Any]  # the newest one

    def __init__(self, node: Node, profile: Profile, clock: StackClock, ego: EgoFeed) -> None:
        """Listen to the stack; `clock` and `ego` tell which step an answer is for, and the motion that it changes."""
        self._clock, self._ego = clock, ego
        self.newest: int | None = None
        self.answered, self.is_heard = -1, False
        self._planned: int | None = None  # newest step that has a trajectory of the stack; -1 before the run
        self._since_plan = 0  # commands since
        self._early: EgoCommand | None = None  # answer by a command that may follow an older trajectory
        self._control_to, self._path_to = publisher_on(node, EGO_CONTROL), publisher_on(node, EGO_TRAJECTORY)
        if profile.answers == TRAJECTORY:
            node.create_subscription(Trajectory, profile.trajectory, self._on_trajectory, QOS)
        else:
            node.create_subscription(Control, profile.control, self._on_control, QOS)
            node.create_subscription(Trajectory, profile.trajectory, self._on_plan, QOS, raw=True)

    def begin_run(self, run: AnnouncedRun) -> None:
        """Take the run whose steps are answered."""
        self._run = run

    def repeat(self) -> None:
        """Publish the newest answer again."""
        publisher, message = self._answer
        publisher.publish(message)

    def respond_early(self) -> None:
        """Answer without the trajectory of the step where it has not come in time, if there is a command."""
        if self._early is not None and self._early.step > self.answered:
            self.respond(self._early)

    def respond(self, answer: EgoCommand) -> None:
        """Answer the step of a command."""
        self._publish(answer.step, self._control_to, messages.ego_to_message(answer, self._run.run_id))

    def _publish(self, step: int, publisher: Publisher, message: Any) -> None:
        """Answer a step; in lock-step its time then passes while the bridge makes the next one."""
        publisher.publish(message)
        self.answered, self._answer = step, (publisher, message)
        if not self._run.is_realtime and step == self._clock.steps.current:
            self._clock.steps.finish()

    def _step_answered(self, stamp: Any) -> int | None:
        """The step that a message of the stack answers; None for one that has an answer, or before the run."""
        self.is_heard = True
        if not self._clock.is_released or self.newest is None:
            return None
        step = min(self._clock.timeline.step_of(stamp.sec * 10**9 + stamp.nanosec), self.newest)
        return step if step > self.answered else None

    def _on_control(self, message: Control) -> None:
        self._since_plan += 1
        step, motion = self._step_answered(message.stamp), self._ego.motion
        if step is None or motion is None:
            return
        acceleration, angle = float(message.longitudinal.acceleration), float(message.lateral.steering_tire_angle)
        answer = vehicle.command(step, acceleration, angle, motion.speed, self._run.geometry.wheelbase)
        if self._run.is_realtime or self._planned is None or (self._planned >= step and self._since_plan > 1):
            self.respond(answer)
        else:
            self._early = answer

    def _on_plan(self, data: bytes) -> None:
        """Note that a step has a trajectory."""
        if self.newest is not None:
            step = min(self._clock.timeline.step_of(stamp_ns(data)), self.newest)
            if self._planned is None or step > self._planned:
                self._planned, self._since_plan = step, 0

    def _on_trajectory(self, message: Trajectory) -> None:
        step, motion = self._step_answered(message.header.stamp), self._ego.motion
        if step is None or motion is None:
            return
        path = Path(header=messages.header(step))
        if len(message.points) > 1:
            points = np.array([(p.pose.position.x, p.pose.position.y) for p in message.points])
            speeds = np.array([p.longitudinal_velocity_mps for p in message.points])
            lever = self._run.geometry.rear_axle_to_centre
            path.poses = poses(vehicle.future_of(points, speeds, motion, lever, HORIZON_S), step)
        self._publish(step, self._path_to, path)


def poses(future: FloatArray, step: int) -> list[PoseStamped]:
    """Poses of a path for the ego port: (k, 3) time after the step [s], x, y [m]."""
    stamped_poses = []
    for after, x, y in future.tolist():
        pose = PoseStamped(header=messages.header(step))
        time_ns = step * STEP_NS + round(after * 1e9)
        pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(time_ns, 10**9)
        pose.pose.position.x, pose.pose.position.y = x, y
        stamped_poses.append(pose)
    return stamped_poses
