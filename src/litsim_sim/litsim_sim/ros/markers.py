"""Agents, forecasts and conflicts as ``visualization_msgs/MarkerArray``, in frame map and the report's colours.

Markers have no lifetime, so that a paused replay stays visible; vanished ones are deleted by the next array.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Vector3
from litsim_msgs.msg import JointForecast, Takeover, Takeovers
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from litsim_sim.core.colours import COLOURS, CONFLICT, MODES_OFF_LOG, Mode
from litsim_sim.core.scene import AgentTable, FloatArray, Kind
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.core.vehicle import HEIGHTS
from litsim_sim.ros.messages import header, place_at

LABEL = 1.4  # [m] height of text
LINE = 0.15  # [m] width of lines
POINTS_MAX = 13  # most points of a forecast

_Key = tuple[str, int]
"""Identity of a marker in its topic: namespace, and id of the agent."""


class Layer:
    """The markers of one topic, which are reused, since constructing messages is slow in Python."""

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}  # marker id by agent id: the former have 32 bits, the latter 64
        self._shown: dict[_Key, Marker] = {}

    def array(self, step: int, wanted: Iterable[tuple[_Key, Marker]]) -> MarkerArray:
        """Returns the `wanted` markers at a step, with deletions of those shown before and no longer wanted."""
        before, self._shown = self._shown, dict(wanted)
        stamped = header(step)
        gone = [
            Marker(header=stamped, ns=key[0], id=marker.id, action=Marker.DELETE)
            for key, marker in before.items()
            if key not in self._shown
        ]
        for marker in self._shown.values():
            marker.header = stamped
        return MarkerArray(markers=[*gone, *self._shown.values()])

    def marker(self, namespace: str, agent: int, kind: int, **fields: Any) -> tuple[_Key, Marker]:
        """Returns the marker of an agent in a namespace: the one shown already, or a new one with `fields`."""
        key = (namespace, agent)
        if key not in self._shown or self._shown[key].type != kind:  # another type: of an agent of another run
            number = self._numbers.setdefault(agent, len(self._numbers))
            self._shown[key] = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, **fields)
            self._shown[key].pose.orientation.w = 1.0
        return key, self._shown[key]


class AgentLayer(Layer):
    """Boxes (namespace `agents`) with the speed in m/s above (namespace `speed`); pedestrians are cylinders."""

    def draw(self, table: AgentTable, modes: Mapping[int, Mode] = {}) -> MarkerArray:
        """Returns the markers of `table`; `modes` are those of agents under POLICY, by id, as far as they are known."""
        return self.array(table.step, self._markers(table, modes))

    def _markers(self, table: AgentTable, modes: Mapping[int, Mode]) -> Iterator[tuple[_Key, Marker]]:
        names = ("id", "kind", "controller", "x", "y", "yaw", "speed", "length", "width")
        finite = np.isfinite(table.x + table.y + table.yaw + table.speed)
        columns = [getattr(table, name)[finite].tolist() for name in names]
        for agent, kind, controller, x, y, yaw, speed, length, width in zip(*columns, strict=True):
            mode = modes.get(agent, controller) if controller == Mode.POLICY else controller
            key, box = self.marker("agents", agent, Marker.CYLINDER if kind == Kind.PEDESTRIAN else Marker.CUBE)
            height = HEIGHTS.get(kind, HEIGHTS[Kind.UNKNOWN])
            _place(box.pose, x, y, 0.5 * height, yaw)
            box.scale.x, box.scale.y, box.scale.z = length, width, height
            box.color = _MODES.get(mode, _MODES[Mode.LOG])
            yield key, box
            key, label = self.marker("speed", agent, Marker.TEXT_VIEW_FACING, scale=Vector3(z=LABEL), color=_INK)
            _place(label.pose, x, y, height + LABEL, 0.0)
            label.text = f"{speed:.1f}"
            yield key, label


class ForecastLayer(Layer):
    """The mean of every valid forecast as a line strip (namespace `forecasts`)."""

    def draw(self, message: JointForecast) -> MarkerArray:
        """Returns the markers of a joint forecast."""
        return self.array(message.step, self._markers(message))

    def _markers(self, message: JointForecast) -> Iterator[tuple[_Key, Marker]]:
        count = len(message.id)
        mean = np.array(message.mean, np.float64).reshape(count, -1, 2) if count else np.empty((0, 0, 2))
        usable = np.array(message.valid, np.bool_) & np.isfinite(mean).all((1, 2))
        stride = max(1, -(-mean.shape[1] // POINTS_MAX))
        for row in np.flatnonzero(usable).tolist():
            key, line = self.marker("forecasts", message.id[row], Marker.LINE_STRIP, scale=Vector3(x=LINE), color=_SKY)
            line.points = _points(mean[row, ::-stride][::-1])
            yield key, line


class ConflictLayer(Layer):
    """Conflicts of the agents that are held, in four namespaces.

    `conflicts`: its box at the predicted overlap. `opponents`: a line from it to its opponent. `paths`: the reference
    path. `goals`: the crossing point that the path leads to.
    """

    def draw(self, message: Takeovers, table: AgentTable | None) -> MarkerArray:
        """Returns the markers of a step's takeovers; sizes and opponents as in `table`, maybe of another step."""
        held = [takeover for takeover in message.takeovers if takeover.state == Takeover.HELD]
        return self.array(message.step, (marker for takeover in held for marker in self._markers(takeover, table)))

    def _markers(self, takeover: Takeover, table: AgentTable | None) -> Iterator[tuple[_Key, Marker]]:
        agent, conflict, goal = takeover.agent, takeover.conflict_pose, takeover.goal_pose
        row, other = (-1, -1) if table is None else (table.row(agent), table.row(takeover.opponent))
        key, box = self.marker("conflicts", agent, Marker.CUBE, color=_OVERLAP)
        size = (4.5, 2.0) if table is None or row < 0 else (float(table.length[row]), float(table.width[row]))
        box.scale.x, box.scale.y, box.scale.z = *size, 0.5 * HEIGHTS[Kind.CAR]
        _place(box.pose, conflict.x, conflict.y, 0.25 * HEIGHTS[Kind.CAR], conflict.theta)
        yield key, box
        if table is not None and min(row, other) >= 0:
            key, line = self.marker("opponents", agent, Marker.LINE_STRIP, scale=Vector3(x=LINE), color=_OVERLAP)
            line.points = _points(np.column_stack([table.x, table.y])[[row, other]], HEIGHTS[Kind.CAR])
            yield key, line
        path = np.array(takeover.reference_path, np.float64).reshape(-1, 2)
        if len(path) > 1:
            key, line = self.marker("paths", agent, Marker.LINE_STRIP, scale=Vector3(x=LINE), color=_MODES[Mode.POLICY])
            line.points = _points(path)
            yield key, line
        key, end = self.marker("goals", agent, Marker.CYLINDER, color=_MODES[Mode.POLICY])
        end.scale.x, end.scale.y, end.scale.z = 1.0, 1.0, 0.1
        _place(end.pose, goal.x, goal.y, 0.05, 0.0)
        yield key, end


def modes_off_log(message: Takeovers) -> dict[int, Mode]:
    """Returns the modes of the agents off their logs, by id."""
    return {takeover.agent: MODES_OFF_LOG[TakeoverState(takeover.state)] for takeover in message.takeovers}


def _colour(text: str, alpha: float = 1.0) -> ColorRGBA:
    red, green, blue = (int(text[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)


def _place(pose: Pose, x: float, y: float, z: float, yaw: float) -> None:
    place_at(pose, x, y, yaw)
    pose.position.z = z


def _points(line: FloatArray, z: float = 0.2) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y in line.tolist()]


_MODES = {mode: _colour(text) for mode, (text, _) in COLOURS.items()}
_INK, _SKY, _OVERLAP = _colour("#ffffff"), _colour("#7db2ff", 0.8), _colour(CONFLICT, 0.6)
