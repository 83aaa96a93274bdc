"""One step of the world as arrays: the state that flows through every stage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from operator import attrgetter
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from litsim_sim.kernels.compiled import Bytes, Floats, Ints, kernel, tuple_of

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
ByteArray = npt.NDArray[np.uint8]
BoolArray = npt.NDArray[np.bool_]
_DTYPES: dict[Any, type[np.generic]] = {"FloatArray": np.float64, "IntArray": np.int64, "ByteArray": np.uint8}


STEP_S = 0.1  # [s] of one step: LitSim runs at NGSIM's 10 Hz
RATE_HZ = 10.0
STEP_NS = round(STEP_S * 1e9)  # [ns] of one step: stamps are whole numbers of nanoseconds


class Kind(IntEnum):
    """Class of an agent, numbered as in ``litsim_msgs/AgentStates``."""

    CAR = 0
    TRUCK = 1
    MOTORCYCLE = 2
    BICYCLE = 3
    PEDESTRIAN = 4
    UNKNOWN = 255


OBSTACLE_KINDS = (Kind.BICYCLE, Kind.PEDESTRIAN)
"""Kinds that do not keep to lanes and follow their logs unless a vehicle off its log blocks their way.

Vehicles under control yield to them.
"""


_BICYCLE, _PEDESTRIAN = (int(kind) for kind in OBSTACLE_KINDS)  # numpy compares plain numbers much faster


def is_obstacle(kind: ByteArray) -> BoolArray:
    """Returns whether kinds (n,) of agents are among the OBSTACLE_KINDS (n,)."""
    return np.asarray((kind == _BICYCLE) | (kind == _PEDESTRIAN), np.bool_)


class Controller(IntEnum):
    """Controller of an agent, numbered as in ``litsim_msgs/AgentStates``."""

    LOG = 0
    POLICY = 1
    EGO = 2


_LOG, _POLICY, _EGO = (int(controller) for controller in Controller)  # plain numbers, as above


@kernel
def walks_or_cycles(kind: int) -> bool:
    """Whether an agent of this kind is among the OBSTACLE_KINDS."""
    return kind in (_BICYCLE, _PEDESTRIAN)


@kernel
def index_of(ids: Ints, agents: Ints) -> Ints:
    """Returns the indices (m,) of `agents` (m,) in the ascending `ids` (n,); -1 for those that are not there."""
    index, place = np.full(len(agents), -1, np.int64), 0
    for k in range(len(agents)):
        if place == len(ids) or ids[place] != agents[k]:  # the agent is not the next of the ids
            place = np.searchsorted(ids, agents[k])
        if place < len(ids) and ids[place] == agents[k]:
            index[k] = place
            place += 1
    return index


class AgentArrays(NamedTuple):
    """The columns (n,) of an :class:`AgentRows` that kernels read, and the scene of each agent."""

    id: Ints
    scene: Ints
    kind: Bytes
    controller: Bytes
    x: Floats
    y: Floats
    yaw: Floats
    speed: Floats
    acceleration: Floats
    yaw_rate: Floats
    length: Floats
    width: Floats


@dataclass
class AgentRows:
    """States of agents in rows, by scene; every array has shape (n,), and ids ascend within a scene.

    A scene is a set of agents that can interact: those of one run at one step.

    Tables must not be changed after they are made; a frozen dataclass would enforce it, but takes six times as long.

    Attributes:
        step: integer step of 0.1 s since the start of the scenario, of the first scene.
        id: ids of the recording; of a batch, those of :class:`litsim_sim.scenario.batched.BatchedLog`.
        kind: :class:`litsim_sim.core.scene.Kind`.
        controller: :class:`Controller`.
        x, y: box centre in frame map [m].
        yaw: heading, counter-clockwise from +x [rad].
        speed: along the heading [m/s].
        acceleration: along the heading [m/s2].
        yaw_rate: [rad/s].
        length, width: size of the box [m].
        scene: number of the scene that each agent is in, ascending; by default all are in scene 0.
    """

    step: int
    id: IntArray
    kind: ByteArray
    controller: ByteArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    yaw_rate: FloatArray
    length: FloatArray
    width: FloatArray
    scene: IntArray = None  # type: ignore[assignment]  # never None once it is made

    def __post_init__(self) -> None:
        if vars(self)["scene"] is None:
            self.scene = np.zeros(len(self.id), np.int64)

    def __len__(self) -> int:
        return len(self.id)

    def take(self, rows: IntArray | BoolArray) -> Self:
        """Returns a table of the agents in `rows`, which are ascending positions or a mask (n,)."""
        indices = rows.nonzero()[0] if rows.dtype == np.bool_ else rows
        return type(self)(self.step, *[column[indices] for column in COLUMNS(self)])

    @cached_property
    def obstacle(self) -> BoolArray:
        """(n,) pedestrians and cyclists; see :data:`OBSTACLE_KINDS`."""
        return is_obstacle(self.kind)

    @property
    def off_log(self) -> BoolArray:
        """(n,) agents whose motion is not the recorded one, the ego included."""
        return self.controller != _LOG

    @property
    def of_policy(self) -> BoolArray:
        """(n,) agents that the policy drives."""
        return self.controller == _POLICY

    @property
    def of_ego(self) -> BoolArray:
        """(n,) egos."""
        return self.controller == _EGO

    @cached_property
    def arrays(self) -> AgentArrays:
        """The table as kernels take it."""
        return tuple_of(AgentArrays, self)


class AgentTable(AgentRows):
    """All agents at one step; `id` ascends.

    They are in one scene, unless several runs are stepped together (:mod:`litsim_sim.scenario.batched`).
    """

    def row(self, agent: int) -> int:
        """Returns the row of `agent`, or -1 where it is not on the road."""
        row = int(self.id.searchsorted(agent))
        return row if row < len(self.id) and self.id[row] == agent else -1

    def rows(self, agents: IntArray) -> IntArray:
        """Returns the row of each of `agents` (m,) in this table (m,); -1 for those that are not on the road."""
        return index_of(self.id, agents)

    def mask(self, agents: IntArray) -> BoolArray:
        """Returns the mask (n,) of the agents of this table that are among `agents` (m,)."""
        mask, rows = np.zeros(len(self), np.bool_), self.rows(agents)
        mask[rows[rows >= 0]] = True
        return mask

    @classmethod
    def merged(cls, step: int, tables: Sequence[AgentTable]) -> Self:
        """Returns the agents of several tables, which have no agent in common, as one table of `step`."""
        columns = [np.concatenate(parts) for parts in zip(*map(COLUMNS, tables), strict=True)]
        order = columns[0].argsort(kind="stable")  # by id
        return cls(step, *[values[order] for values in columns])

    @classmethod
    def of_message(cls, message: Any) -> Self:
        """Returns the table of an ``AgentStates``, of ROS or decoded from a recording."""
        return cls(message.step, *(np.array(getattr(message, name), dtype) for name, dtype in DTYPES.items()))

    @classmethod
    def empty(cls, step: int) -> AgentTable:
        """Returns the table of a step without agents."""
        return cls(step, *(np.empty(0, dtype) for dtype in DTYPES.values()))


COLUMNS: Callable[[AgentRows], tuple[Any, ...]] = attrgetter(*(f.name for f in fields(AgentRows)[1:]))
"""The arrays of a table, in the order of its fields."""


@dataclass
class ControlTable:
    """The policy's answer to one step; agents that are not listed follow their logs. Arrays (m,), ids ascending.

    Attributes:
        step: the step to which it is the answer.
        id: agents.
        acceleration: along the heading [m/s2].
        lateral_acceleration: to the left [m/s2].
        yaw_rate: [rad/s].
        source: :class:`ControlSource`.
    """

    step: int
    id: IntArray
    acceleration: FloatArray
    lateral_acceleration: FloatArray
    yaw_rate: FloatArray
    source: ByteArray

    @classmethod
    def of_message(cls, message: Any) -> ControlTable:
        """Returns the table of a ``Controls``, of ROS or decoded from a recording."""
        return cls(message.step, *(np.array(getattr(message, name), dtype) for name, dtype in CONTROL_DTYPES.items()))

    @classmethod
    def empty(cls, step: int) -> ControlTable:
        """Returns the answer to `step` that lists no agents: all follow their logs."""
        return cls(step, *(np.empty(0, dtype) for dtype in CONTROL_DTYPES.values()))

    @classmethod
    def merged(cls, *tables: ControlTable) -> ControlTable:
        """Returns the controls of several tables of a step, ids ascending; no agent is in two of them."""
        listed = [table for table in tables if len(table.id)]
        if len(listed) <= 1:
            return listed[0] if listed else tables[0]
        order = np.concatenate([table.id for table in listed]).argsort(kind="stable")
        columns = {f: np.concatenate([getattr(table, f) for table in listed])[order] for f in CONTROL_DTYPES}
        return cls(tables[0].step, **columns)

    def take(self, rows: BoolArray) -> ControlTable:
        """Returns the controls of the agents in the mask `rows` (m,)."""
        return ControlTable(self.step, **{f: getattr(self, f)[rows] for f in CONTROL_DTYPES})

    @classmethod
    def without_slip(
        cls, table: AgentTable, rows: IntArray, acceleration: FloatArray, yaw_rate: FloatArray, source: ByteArray
    ) -> ControlTable:
        """Returns the answer to the step of `table` for the agents in `rows` (m,), which move without lateral slip.

        Their lateral acceleration is speed times yaw rate; the other arguments are arrays (m,), as in the attributes.
        """
        return cls(table.step, table.id[rows], acceleration, table.speed[rows] * yaw_rate, yaw_rate, source)

    @classmethod
    def of_policy(
        cls, table: AgentTable, rows: IntArray, acceleration: FloatArray, yaw_rate: FloatArray
    ) -> ControlTable:
        """Controls as by :meth:`without_slip`, all with the policy as their source."""
        source = np.full(len(rows), ControlSource.POLICY, np.uint8)
        return cls.without_slip(table, rows, acceleration, yaw_rate, source)


DTYPES, CONTROL_DTYPES = (
    {f.name: _DTYPES[f.type] for f in fields(table) if f.type in _DTYPES and f.name != "scene"}
    for table in (AgentTable, ControlTable)
)
"""Types of the columns that describe an agent, and of those of its controls, as in messages; `id` is the first."""
ARRAY_FIELDS = tuple(DTYPES)


class ControlSource(IntEnum):
    """Where a command comes from, numbered as in ``litsim_msgs/Controls``."""

    POLICY = 1
    HANDBACK = 2
    GUARDED = 4
    LATE = 5


class EgoMode(IntEnum):
    """Mode of the ego's answer, numbered as in ``litsim_msgs/EgoControl``."""

    CONTROL = 0
    FOLLOW_LOG = 1


@dataclass
class EgoCommand:
    """The ego's answer to one step: an acceleration [m/s2] and a yaw rate [rad/s], or that it follows its log."""

    step: int
    acceleration: float = 0.0
    yaw_rate: float = 0.0
    mode: EgoMode = EgoMode.CONTROL

    @classmethod
    def of_message(cls, message: Any) -> EgoCommand:
        """Returns the command of an ``EgoControl``; raises ValueError if its mode is unknown."""
        if message.mode not in [*EgoMode]:
            modes = " or ".join(f"{mode} ({mode.name})" for mode in EgoMode)
            raise ValueError(f"mode is {message.mode}, expected {modes}")
        return cls(message.step, message.acceleration, message.yaw_rate, EgoMode(message.mode))
