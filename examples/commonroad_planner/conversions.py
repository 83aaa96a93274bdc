"""From the ego port's standard messages to arrays and back; numpy and message types, no planner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.time import Time

STEP_S = 0.1
STEP_NS = 100_000_000
MAP_FRAME = "map"
FORMATS = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}  # of sensor_msgs/PointField


@dataclass(frozen=True)
class Ego:
    """The ego at a step: box centre [m], heading [rad], speed [m/s] and yaw rate [rad/s], in frame map."""

    x: float
    y: float
    yaw: float
    speed: float
    yaw_rate: float


def ego_of(odometry: Any) -> Ego:
    """The ego from ``nav_msgs/Odometry``."""
    pose, twist = odometry.pose.pose, odometry.twist.twist
    yaw = 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    return Ego(pose.position.x, pose.position.y, float(yaw), twist.linear.x, twist.angular.z)


def objects_of(cloud: Any) -> np.ndarray:
    """The points of a ``sensor_msgs/PointCloud2`` as a structured array, a field for each of the cloud's."""
    described = {
        "names": [field.name for field in cloud.fields],
        "formats": [FORMATS[field.datatype] for field in cloud.fields],
        "offsets": [field.offset for field in cloud.fields],
        "itemsize": cloud.point_step,
    }
    return np.frombuffer(bytes(cloud.data), np.dtype(described), count=cloud.width * cloud.height)


def limit_of(lanes: Any) -> float:
    """Returns the lowest speed limit [m/s] of the lanes of ``/litsim/lanes/table`` that are on the route."""
    table = objects_of(lanes)
    return float(table["speed_limit"][table["on_route"] > 0].min())


def line_of(path: Any) -> np.ndarray:
    """(n, 2) positions [m] of a ``nav_msgs/Path``."""
    return np.array([(pose.pose.position.x, pose.pose.position.y) for pose in path.poses], np.float64).reshape(-1, 2)


def lanes_of(markers: Any) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Left border, centre line and right border, (k, 2) each [m], of every lane of ``/litsim/lanes``."""
    lines = {(marker.ns, marker.id): np.array([(p.x, p.y) for p in marker.points]) for marker in markers.markers}
    numbers = sorted(number for name, number in lines if name == "centre")
    return [(lines["boundary", 2 * n], lines["centre", n], lines["boundary", 2 * n + 1]) for n in numbers]


def lengthened(line: np.ndarray, before: float, after: float) -> np.ndarray:
    """A polyline (n, 2) with straight ends of `before` and `after` metres, and no vertex twice."""
    line = line[np.append(True, np.hypot(*np.diff(line, axis=0).T) > 1e-3)]
    first, last = line[0] - line[1], line[-1] - line[-2]
    begin = line[0] + before * first / np.hypot(*first)
    end = line[-1] + after * last / np.hypot(*last)
    return np.concatenate([begin[None], line, end[None]])


def sampled(line: np.ndarray, spacing: float) -> np.ndarray:
    """Points (m, 2) along a polyline (n, 2), its ends among them, at equal distances of at most `spacing` metres.

    A spline through them cannot fold back on itself, as one through vertices at uneven distances may.
    """
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / spacing)) + 1)
    return np.stack([np.interp(at, along, line[:, k]) for k in (0, 1)], axis=-1)


def predicted(objects: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(n, m, 2) box centres [m] of `objects` at `times` (m,) [s] from now: on at their velocity."""
    now = np.stack([objects["x64"], objects["y64"]], axis=-1)
    velocity = np.stack([objects["vx"], objects["vy"]], axis=-1).astype(np.float64)
    return now[:, None] + times[None, :, None] * velocity[:, None]


def ahead_and_left(objects: np.ndarray, ego: Ego) -> tuple[np.ndarray, np.ndarray]:
    """Where `objects` are in the ego's frame [m]."""
    away = (objects["x64"] - ego.x + 1j * (objects["y64"] - ego.y)) * np.exp(-1j * ego.yaw)
    return away.real, away.imag


def braking(line: np.ndarray, ego: Ego, deceleration: float, steps: int) -> np.ndarray:
    """(steps, 2) box centres [m], 0.1 s apart and from now on, of a stop along `line` (n, 2), side by side with it.

    The line goes on straight at its end; the distance of the ego to it is kept.
    """
    line = lengthened(line, 1.0, 200.0)
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    at = np.array([ego.x, ego.y])
    step = np.diff(line, axis=0)
    share = np.clip(((at - line[:-1]) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0)
    feet = line[:-1] + share[:, None] * step
    nearest = int(np.argmin(np.hypot(*(feet - at).T)))
    begin = along[nearest] + share[nearest] * np.hypot(*step[nearest])
    time = np.minimum(STEP_S * np.arange(steps), ego.speed / deceleration)
    gone = begin + ego.speed * time - 0.5 * deceleration * time**2
    points = np.stack([np.interp(gone, along, line[:, axis]) for axis in (0, 1)], axis=1)
    return points + (at - feet[nearest])


def path_message(stamp_ns: int, points: np.ndarray) -> Path:
    """``nav_msgs/Path`` that answers the step of `stamp_ns`: box centres (n, 2) [m] from then on, 0.1 s apart."""
    message = Path()
    message.header.frame_id, message.header.stamp = MAP_FRAME, Time(nanoseconds=stamp_ns).to_msg()
    for row, (x, y) in enumerate(points.tolist()):
        pose = PoseStamped()
        pose.header.frame_id, pose.header.stamp = MAP_FRAME, Time(nanoseconds=stamp_ns + row * STEP_NS).to_msg()
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = x, y, 1.0
        message.poses.append(pose)
    return message
