"""The lane graph in a standard message type: clouds with a point for each lane, and for each way from lane to lane."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import PointCloud2

from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import SignalLink
from litsim_sim.ros.messages import header, place_at
from litsim_sim.ros.standard import NONE, cloud
from litsim_sim.scenario.mission import Mission

_LANE = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "yaw", "length", "width", "speed_limit", "entered")),
        ("left", "<u4"),
        ("right", "<u4"),
        ("inside_junction", "u1"),
        ("on_route", "u1"),
        ("padding", "V6"),
        ("x64", "<f8"),
        ("y64", "<f8"),
    ]
)
_LINK = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z")),
        *((name, "<u4") for name in ("lane", "to_lane", "light")),
        ("stop", "u1"),
        ("give_way", "u1"),
        ("padding", "V6"),
        ("x64", "<f8"),
        ("y64", "<f8"),
    ]
)


def goal_pose(mission: Mission) -> PoseStamped:
    """Returns the pose of the ego's box centre at its goal, in frame map."""
    message = PoseStamped(header=header(0))
    place_at(message.pose, *mission.goal.tolist())
    return message


def lane_table(lane_map: LaneMap, mission: Mission) -> PointCloud2:
    """Returns the lanes, as points of a cloud in frame map in the order of :func:`.standard.lanes`.

    Fields: x, y, z, yaw where the lane begins, length, width, speed_limit, and entered (how far along the route its
    path enters the lane, NaN if it does not) as FLOAT32 [m, rad, m/s]; left and right, numbers of the lanes beside it,
    as UINT32, 0xFFFFFFFF for none; inside_junction and on_route as UINT8; x64 and y64 as FLOAT64.
    """
    points, number = np.zeros(len(lane_map.lanes), _LANE), _numbers(lane_map)
    for point, lane in zip(points, lane_map.lanes, strict=True):
        _place(point, lane.centerline[0], lane.heights)
        point["yaw"] = lane.headings[0]
        point["length"], point["width"], point["inside_junction"] = lane.length, lane.width, lane.is_internal
        point["left"], point["right"] = (number.get(side or "", NONE) for side in (lane.left, lane.right))
    points["speed_limit"], points["entered"] = lane_map.speed_limits, mission.entered
    points["on_route"] = mission.on_route
    return cloud(0, points)


def lane_links(lane_map: LaneMap, links: tuple[SignalLink, ...]) -> PointCloud2:
    """Returns which lanes follow which, as points of a cloud in frame map where a lane ends and another begins.

    Fields: x, y, z as FLOAT32 [m]; lane and to_lane, numbers of the lanes as in :func:`lane_table`, and light, the
    number of the point of :class:`.standard.Lights` that controls the way, 0xFFFFFFFF for none, as UINT32; stop,
    whether a stop sign stands there, and give_way, whether the way gives way by signs, as UINT8; x64 and y64 as
    FLOAT64. `links` are the controlled connections in their order.
    """
    number = _numbers(lane_map)
    light = {(link.from_lane, (*link.via, link.to_lane)[0]): row for row, link in enumerate(links)}
    pairs = [(lane, name) for lane in lane_map.lanes for name in lane.successors]
    points = np.zeros(len(pairs), _LINK)
    for point, (lane, name) in zip(points, pairs, strict=True):
        _place(point, lane.centerline[-1], None if lane.heights is None else lane.heights[::-1])
        point["lane"], point["to_lane"] = number[lane.id], number[name]
        point["light"] = light.get((lane.id, name), NONE)
        point["stop"], point["give_way"] = name in lane.stops, name in lane.gives_way
    return cloud(0, points)


def _numbers(lane_map: LaneMap) -> dict[str, int]:
    return {lane.id: row for row, lane in enumerate(lane_map.lanes)}


def _place(point: np.void, position: FloatArray, heights: FloatArray | None) -> None:
    point["x"], point["y"] = point["x64"], point["y64"] = position
    point["z"] = 0.0 if heights is None else heights[0]
