"""Takeovers: why an agent is off its log, and where it is headed."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np

from litsim_sim.core.scene import FloatArray, IntArray

Pose = tuple[float, float, float]
"""x [m], y [m], yaw [rad] in frame map."""


class TakeoverState(IntEnum):
    """Phase of a takeover, numbered as in ``litsim_msgs/Takeover``."""

    HELD = 0
    HANDBACK = 1
    RELEASED = 2
    OWN_INTENT = 3

    @property
    def drives_on(self) -> bool:
        """Whether the policy drives the agent on along its path, rather than back to its log."""
        return self in (TakeoverState.HELD, TakeoverState.OWN_INTENT)


class TakeoverReason(IntEnum):
    """Why an agent was taken over, numbered as in ``litsim_msgs/Takeover``."""

    CONFLICT = 0
    BLOCKED_ENTRY = 1
    REGION = 2
    UNLIKELY = 3


class PathSource(IntEnum):
    """Origin of a reference path, numbered as in ``litsim_msgs/Takeover``.

    LANE: the lane that an agent of a baseline keeps to, or an adjacent one that an agent takes to pass.
    """

    ROUTE = 0
    LOGGED = 1
    LANE = 2


@dataclass
class Takeover:
    """One agent off its log at one step; see ``litsim_msgs/Takeover``. Older recordings lack fields with a default.

    Attributes:
        agent, opponent: ids.
        detected_step: step at which the agent was taken over.
        time_to_conflict: from then to the predicted overlap [s].
        overlap_probability: largest within the horizon, at detection.
        conflict_pose, goal_pose: pose of the agent at the predicted overlap, and the pose that it is headed for.
        reference_path: (m, 2) points in frame map [m], from a little behind the agent on.
        log_collision_predicted: whether the agent's log itself leads into the opponent's forecast, at this step.
        residual_position, residual_speed: distance from the delayed log [m], and speed minus that of the delayed log
            [m/s]; -1 and 0 without a logged pose `time_shift` before this step.
        path_source: origin of the reference path.
        time_shift: lag of the log that the agent returns to [s].
        log_ratio: how much less likely a person would do what the log does next than in the recorded scene, as the
            logarithm of the ratio of both probabilities; 0 where the scene is as recorded.
    """

    agent: int
    opponent: int
    state: TakeoverState
    reason: TakeoverReason
    detected_step: int
    time_to_conflict: float
    overlap_probability: float
    conflict_pose: Pose
    goal_pose: Pose
    reference_path: FloatArray
    log_collision_predicted: bool
    residual_position: float
    residual_speed: float
    path_source: PathSource = PathSource.ROUTE
    time_shift: float = 0.0
    log_ratio: float = 0.0

    @classmethod
    def of_message(cls, message: Any) -> Takeover:
        """Returns the takeover of a ``Takeover``, of ROS or decoded from a recording."""
        names = [field.name for field in fields(cls) if field.default is MISSING or hasattr(message, field.name)]
        of_fields = {name: getattr(message, name) for name in names}
        of_fields |= {name: (pose.x, pose.y, pose.theta) for name, pose in of_fields.items() if name.endswith("_pose")}
        return cls(
            **of_fields
            | {
                "state": TakeoverState(message.state),
                "reason": TakeoverReason(message.reason),
                "path_source": PathSource(of_fields.get("path_source", PathSource.ROUTE)),
                "reference_path": np.array(message.reference_path, np.float64).reshape(-1, 2),
            }
        )

    @property
    def predicted(self) -> bool:
        """Whether a conflict was predicted; else `time_to_conflict` and `overlap_probability` are placeholders."""
        return self.reason == TakeoverReason.CONFLICT


@dataclass
class TakeoverTable:
    """All agents off their logs at `step`, ascending.

    Attributes:
        iterations: iterations of the detection until nothing new was found.
        converged: False if the bound on iterations was reached.
    """

    step: int
    takeovers: tuple[Takeover, ...] = ()
    iterations: int = 0
    converged: bool = True

    @classmethod
    def of_message(cls, message: Any) -> TakeoverTable:
        """Returns the table of a ``Takeovers``, of ROS or decoded from a recording."""
        takeovers = tuple(map(Takeover.of_message, message.takeovers))
        return cls(message.step, takeovers, message.iterations, message.converged)

    def without(self, agents: IntArray) -> TakeoverTable:
        """Returns the takeovers of all agents but `agents` (m,)."""
        left_out = set(agents.tolist())
        return replace(self, takeovers=tuple(t for t in self.takeovers if t.agent not in left_out))
