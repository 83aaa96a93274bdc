"""The scene in standard message types, readable for any stack and viewer: clouds of agents and lights, and markers."""

from __future__ import annotations

from array import array
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from litsim_sim.core.colours import LIGHTS
from litsim_sim.core.geometry import shift_left
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import stop_line_parts
from litsim_sim.record.clouds import fields_of, object_points
from litsim_sim.ros.messages import header
from litsim_sim.ros.topics import OBJECTS
from litsim_sim.scenario.signals import Signals

_LIGHT = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "yaw", "width")),
        ("lane", "<u4"),
        ("to_lane", "<u4"),
        ("state", "u1"),
        ("padding", "V3"),
        *((name, "<f8") for name in ("x64", "y64", "exit_x64", "exit_y64")),
    ]
)
NONE = 0xFFFFFFFF  # of numbers in clouds: there is no such lane or light
_COARSE = 0.01  # [m] rounding of x and y from which on x64 and y64 are needed
_CENTRE = ColorRGBA(r=0.55, g=0.55, b=0.6, a=0.6)
_BOUNDARY = ColorRGBA(r=1.0, g=1.0, b=1.0, a=0.9)
_LINE_WIDTH = 0.12  # [m]
_STOP_LINE_WIDTH = 0.4  # [m]
_LIGHT_COLOURS = {state: ColorRGBA(r=r, g=g, b=b, a=1.0) for state, (r, g, b) in LIGHTS.items()}


def objects(table: AgentTable, ego_id: int) -> PointCloud2:
    """Returns every agent but the ego as a point of a cloud in frame map.

    Fields: x, y, z (0), yaw, speed, vx, vy, length, width as FLOAT32 [m, rad, m/s], id as UINT32 (the low 32 bits of
    the recording's), kind as UINT8 (as in ``litsim_msgs/AgentStates``); x64 and y64, x and y as FLOAT64: far from the
    origin, as in UTM, FLOAT32 rounds to decimetres. A position is that of a box centre.
    """
    others = table.take(table.id != ego_id)
    return cloud(table.step, object_points(partial(getattr, others), len(others)))


class Lights:
    """What the signals of a scenario show, as a point of a cloud in frame map for each connection that they control.

    Fields: x, y, z (0), yaw of the lane in the middle of its stop line and width of the lane there as FLOAT32 [m, rad];
    lane and to_lane, numbers of the lanes before and after the junction as in :func:`lanes`, as UINT32; state as UINT8
    (:class:`litsim_sim.core.signals.SignalState`); x64 and y64, x and y, and exit_x64 and exit_y64, where to_lane
    begins, as FLOAT64 [m]. The cloud is empty if the scenario has no signals.
    """

    def __init__(self, signals: Signals | None, lane_map: LaneMap) -> None:
        links = () if signals is None else signals.links
        self._signals, self._points = signals, np.zeros(len(links), _LIGHT)
        number = {lane.id: row for row, lane in enumerate(lane_map.lanes)}
        for point, link in zip(self._points, links, strict=True):
            point["x"], point["y"] = point["x64"], point["y64"] = link.stop
            point["yaw"], point["width"] = link.heading, link.width
            point["exit_x64"], point["exit_y64"] = link.exit
            point["lane"], point["to_lane"] = (number.get(lane, NONE) for lane in (link.from_lane, link.to_lane))

    def cloud(self, step: int) -> PointCloud2:
        """Returns the cloud of a step."""
        if self._signals is not None:
            self._points["state"] = self._signals.of_links(step)[0]
        return cloud(step, self._points)


def light_markers(step: int, signals: Signals | None) -> MarkerArray:
    """Returns a stop line (namespace ``stop_lines``) for each connection that signals control, in the colour they show.

    Connections of one lane share its line. `text` is ``FROM_LANE -> TO_LANE STATE``, by SUMO's ids.
    """
    if signals is None:
        return MarkerArray()
    markers = []
    states = map(SignalState, signals.of_links(step)[0].tolist())
    lines = stop_line_parts(signals.links).tolist()
    for row, (link, state, line) in enumerate(zip(signals.links, states, lines, strict=True)):
        marker = Marker(header=header(step), ns="stop_lines", id=row, type=Marker.LINE_STRIP, pose=Pose())
        marker.color, marker.scale.x = _LIGHT_COLOURS[state], _STOP_LINE_WIDTH
        marker.text, marker.points = f"{link.name} {state.name}", [Point(x=x, y=y) for x, y in line]
        markers.append(marker)
    return MarkerArray(markers=markers)


def cloud(step: int, points: np.ndarray[Any, Any]) -> PointCloud2:
    """Returns a structured array (n,) as a cloud with a field for each of its fields but padding, in frame map."""
    layout = points.dtype
    return PointCloud2(
        header=header(step),
        height=1,
        width=len(points),
        fields=_fields(layout),
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=layout.itemsize * len(points),
        data=array("B", points.tobytes()),
        is_dense=True,
    )


@cache
def _fields(layout: np.dtype[Any]) -> list[PointField]:
    return [PointField(name=name, offset=offset, datatype=kind, count=1) for name, offset, kind in fields_of(layout)]


def rounding(table: AgentTable) -> str:
    """Returns a text that says that FLOAT32 is too coarse for positions so far from the origin; empty if it is not."""
    reach = max(np.abs(table.x).max(initial=0.0), np.abs(table.y).max(initial=0.0))
    apart = float(np.spacing(np.float32(reach)))
    return (
        f"{OBJECTS.name}: positions reach {reach:.0f} m, where x and y are rounded to {apart:.2g} m: read x64 and y64"
        if apart > _COARSE
        else ""
    )


@lru_cache(maxsize=1)
def lanes(lane_map: LaneMap) -> MarkerArray:
    """Returns centre lines (namespace ``centre``) and borders (``boundary``, left and right) of lanes, in frame map.

    Lines are in driving direction. `text` is SUMO's id of the lane; `id` is its index, for borders twice the index,
    plus one for the right border.
    """
    markers = []
    for row, lane in enumerate(lane_map.lanes):
        lines = [("centre", row, lane.centerline, _CENTRE)]
        for side in (0, 1):
            border = shift_left(lane.centerline, (0.5 - side) * lane.width)
            lines.append(("boundary", 2 * row + side, border, _BOUNDARY))
        for namespace, number, points, color in lines:
            marker = Marker(header=header(0), ns=namespace, id=number, type=Marker.LINE_STRIP, pose=Pose(), color=color)
            marker.text, marker.scale.x = lane.id, _LINE_WIDTH
            marker.points = [Point(x=x, y=y) for x, y in points.tolist()]
            markers.append(marker)
    return MarkerArray(markers=markers)
