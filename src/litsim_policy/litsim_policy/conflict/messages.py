"""Conversion between :class:`TakeoverTable` and ``litsim_msgs/Takeovers``."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Pose2D
from litsim_msgs.msg import Takeover as TakeoverMessage
from litsim_msgs.msg import Takeovers

from litsim_sim.core.takeover import PathSource, Pose, Takeover, TakeoverReason, TakeoverState, TakeoverTable
from litsim_sim.ros.messages import from_array, header, to_array

_SCALARS = (
    "agent",
    "opponent",
    "detected_step",
    "time_to_conflict",
    "overlap_probability",
    "log_collision_predicted",
    "residual_position",
    "residual_speed",
    "time_shift",
)


def takeovers_to_message(table: TakeoverTable, run_id: str) -> Takeovers:
    """``Takeovers`` of a table."""
    return Takeovers(
        header=header(table.step),
        run_id=run_id,
        step=table.step,
        iterations=table.iterations,
        converged=table.converged,
        takeovers=[
            TakeoverMessage(
                state=int(t.state),
                reason=int(t.reason),
                path_source=int(t.path_source),
                conflict_pose=_to_pose(t.conflict_pose),
                goal_pose=_to_pose(t.goal_pose),
                reference_path=to_array(t.reference_path),
                **{name: getattr(t, name) for name in _SCALARS},
            )
            for t in table.takeovers
        ],
    )


def takeovers_from_message(message: Takeovers) -> TakeoverTable:
    """Table of a ``Takeovers``."""
    return TakeoverTable(
        message.step,
        tuple(
            Takeover(
                state=TakeoverState(t.state),
                reason=TakeoverReason(t.reason),
                path_source=PathSource(t.path_source),
                conflict_pose=_from_pose(t.conflict_pose),
                goal_pose=_from_pose(t.goal_pose),
                reference_path=from_array(t.reference_path, np.float64).reshape(-1, 2),
                **{name: getattr(t, name) for name in _SCALARS},
            )
            for t in message.takeovers
        ),
        message.iterations,
        message.converged,
    )


def _to_pose(pose: Pose) -> Pose2D:
    return Pose2D(x=pose[0], y=pose[1], theta=pose[2])


def _from_pose(pose: Pose2D) -> Pose:
    return pose.x, pose.y, pose.theta
