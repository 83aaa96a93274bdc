"""Conversion between the arrays of the cores and the messages of the graph.

Primitive arrays go in as :class:`array.array`, which is copied as a whole, where rclpy converts lists and numpy arrays
element by element. The classes of the cores read messages (``of_message``), as they are or decoded from a recording.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, Pose2D, PoseStamped
from litsim_msgs.msg import AgentStates, Controls, EgoControl, SignalLink, SignalMap, SignalStates, StageStatus
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Header

from litsim_sim.core import topic_names
from litsim_sim.core.checks import check_columns
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import (
    ARRAY_FIELDS,
    CONTROL_DTYPES,
    STEP_NS,
    AgentTable,
    ControlTable,
    EgoCommand,
    FloatArray,
)
from litsim_sim.core.signals import SignalTable
from litsim_sim.scenario.signals import Signals

FRAME = "map"
_TYPECODES = {"f8": "d", "f4": "f", "i8": "q", "u4": "I", "u1": "B"}


def stamp(step: int) -> Time:
    """Returns the simulation time of a step."""
    seconds, nanoseconds = divmod(step * STEP_NS, 10**9)
    return Time(sec=seconds, nanosec=nanoseconds)


def header(step: int) -> Header:
    """Returns the header of a message about a step, in frame map."""
    return Header(stamp=stamp(step), frame_id=FRAME)


def to_array(values: np.ndarray) -> array:
    """Returns a primitive array field from a numpy array of any shape, row-major."""
    return array(_TYPECODES[values.dtype.str[1:]], np.ascontiguousarray(values).tobytes())


def agents_to_message(table: AgentTable, run_id: str, total_steps: int, ego_id: int) -> AgentStates:
    """Returns ``AgentStates`` of a table."""
    arrays = {name: to_array(getattr(table, name)) for name in ARRAY_FIELDS}
    return AgentStates(
        header=header(table.step), run_id=run_id, step=table.step, total_steps=total_steps, ego_id=ego_id, **arrays
    )


def received_agents(message: AgentStates) -> AgentTable:
    """Returns the table of an ``AgentStates`` received by a stage; raises InputError as :func:`check_columns`."""
    table = AgentTable.of_message(message)
    with refused(topic_names.AGENTS):
        check_columns({name: getattr(table, name) for name in ARRAY_FIELDS})
    return table


@contextmanager
def refused(topic: str) -> Iterator[None]:
    """Turn a ValueError about a message into an InputError that names its topic."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"{topic}: {error}") from error


def signals_to_message(signals: SignalTable, run_id: str) -> SignalStates:
    """Returns ``SignalStates`` of a table."""
    state = to_array(signals.state)
    return SignalStates(
        header=header(signals.step), run_id=run_id, step=signals.step, group=list(signals.group), state=state
    )


def signal_map_to_message(signals: Signals, run_id: str) -> SignalMap:
    """Returns ``SignalMap`` of the signals of a scenario."""
    links = [
        SignalLink(
            from_lane=link.from_lane,
            to_lane=link.to_lane,
            group=group,
            stop=_pose(link.stop, link.heading),
            width=link.width,
            exit=_pose(link.exit, link.exit_heading),
        )
        for link, group in zip(signals.links, signals.link_group.tolist(), strict=True)
    ]
    return SignalMap(header=header(0), run_id=run_id, group=list(signals.groups), links=links)


def controls_to_message(controls: ControlTable, run_id: str) -> Controls:
    """Returns ``Controls`` of a table."""
    arrays = {name: to_array(getattr(controls, name)) for name in CONTROL_DTYPES}
    return Controls(header=header(controls.step), run_id=run_id, step=controls.step, **arrays)


def ego_to_message(command: EgoCommand, run_id: str) -> EgoControl:
    """Returns ``EgoControl`` of a command."""
    return EgoControl(
        header=header(command.step),
        run_id=run_id,
        step=command.step,
        mode=int(command.mode),
        acceleration=float(command.acceleration),
        yaw_rate=float(command.yaw_rate),
    )


def ego_odometry(table: AgentTable, ego_id: int, rear_axle: float) -> Odometry:
    """Pose of the ego's box centre in frame map, twist there in its body frame ``ego``; all zero once it has left.

    `rear_axle` is the distance of the rear axle behind the centre, as a share of the length.
    """
    message = Odometry(header=header(table.step), child_frame_id="ego")
    row = table.row(ego_id)
    if row >= 0:
        twist = message.twist.twist
        place_at(message.pose.pose, float(table.x[row]), float(table.y[row]), float(table.yaw[row]))
        twist.linear.x, twist.angular.z = float(table.speed[row]), float(table.yaw_rate[row])
        twist.linear.y = twist.angular.z * rear_axle * float(table.length[row])
    return message


def route_path(points: FloatArray, step: int) -> Path:
    """Returns ``nav_msgs/Path`` through `points` (m, 2) [m], each pose heading to the next."""
    message = Path(header=header(step))
    direction = np.diff(points, axis=0, append=2.0 * points[-1:] - points[-2:-1])
    for (x, y), yaw in zip(points.tolist(), np.arctan2(direction[:, 1], direction[:, 0]).tolist(), strict=True):
        pose = PoseStamped(header=message.header)
        place_at(pose.pose, x, y, yaw)
        message.poses.append(pose)
    return message


def status(
    run_id: str, stage: str, state: int, step: int = 0, compute_time: float = 0.0, text: str = ""
) -> StageStatus:
    """Returns ``StageStatus`` of a stage."""
    return StageStatus(
        header=header(step), run_id=run_id, step=step, stage=stage, state=state, compute_time=compute_time, text=text
    )


def _pose(place: FloatArray, heading: float) -> Pose2D:
    return Pose2D(x=float(place[0]), y=float(place[1]), theta=float(heading))


def place_at(pose: Pose, x: float, y: float, yaw: float) -> None:
    """Set a pose in the plane: `x`, `y` [m], `yaw` [rad]."""
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = float(np.sin(0.5 * yaw)), float(np.cos(0.5 * yaw))
