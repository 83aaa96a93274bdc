"""Conversion between :class:`TakeoverTable` and ``litsim_msgs/Takeovers``."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from geometry_msgs.msg import Pose2D
from litsim_msgs.msg import Takeover as TakeoverMessage
from litsim_msgs.msg import Takeovers

from litsim_sim.core import topic_names
from litsim_sim.core.checks import check_columns
from litsim_sim.core.takeover import Pose, Takeover, TakeoverTable
from litsim_sim.ros.messages import header, refused, to_array

_SCALARS = tuple(field.name for field in fields(Takeover) if field.type in ("int", "float", "bool"))
_FINITE = tuple(field.name for field in fields(Takeover) if field.type in ("float", "Pose"))
"""Fields of a takeover that must be finite, besides its path."""


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


def received_takeovers(message: Takeovers) -> TakeoverTable:
    """Returns the table of a ``Takeovers`` received by a stage.

    Raises:
        InputError: the message is invalid: agents do not ascend, numbers are not finite, a path has an odd number of
            coordinates, or a state, reason or path source is unknown.
    """
    with refused(topic_names.TAKEOVERS):
        for takeover in message.takeovers:
            if len(takeover.reference_path) % 2:
                raise ValueError(
                    f"reference_path of agent {takeover.agent} has {len(takeover.reference_path)} values, expected x "
                    "and y of each point"
                )
        table = TakeoverTable.of_message(message)
        columns = {name: np.array([getattr(t, name) for t in table.takeovers], np.float64) for name in _FINITE}
        check_columns({"id": np.array([t.agent for t in table.takeovers], np.int64)} | columns)
        for takeover in table.takeovers:
            if not np.isfinite(takeover.reference_path).all():
                raise ValueError(f"reference_path of agent {takeover.agent} is not finite, expected finite numbers")
    return table


def _to_pose(pose: Pose) -> Pose2D:
    return Pose2D(x=pose[0], y=pose[1], theta=pose[2])
