"""Crossings of lanes of a net, which distinguish an intersection from a road."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.net_lanes import Lane

ANGLE_MIN = np.deg2rad(30.0)  # between two lanes that cross; lanes that merge meet at less


def lane_crossings(lanes: Sequence[Lane]) -> FloatArray:
    """Returns the points (k, 2) at which centre lines of two lanes cross, frame map [m]."""
    lines = [shapely.LineString(lane.centerline) for lane in lanes]
    points = [
        (point.x, point.y)
        for i, j in crossing_pairs(lines)
        if i < j
        for point in crossing_points(lines[i], lines[j])
        if _angle(lines[i], lines[j], point) >= ANGLE_MIN
    ]
    return np.array(points).reshape(-1, 2)


def crossing_pairs(lines: Sequence[shapely.LineString]) -> list[tuple[int, int]]:
    """Returns pairs of indices of lines that cross each other, each in both orders."""
    first, second = shapely.STRtree(lines).query(lines, predicate="crosses")
    return list(zip(first.tolist(), second.tolist(), strict=True))


def crossing_points(a: shapely.LineString, b: shapely.LineString) -> list[shapely.Point]:
    """Returns points at which two lines cross; stretches that they share do not count."""
    return [part for part in shapely.get_parts(shapely.intersection(a, b)).tolist() if part.geom_type == "Point"]


def _angle(a: shapely.LineString, b: shapely.LineString, point: shapely.Point) -> float:
    """Returns the angle [rad] between two lines at a point, up to a right angle."""
    return float(np.arccos(np.clip(abs(_direction(a, point) @ _direction(b, point)), 0.0, 1.0)))


def _direction(line: shapely.LineString, point: shapely.Point) -> FloatArray:
    """Returns the unit vector (2,) along a line, over 1 m about a point on it."""
    s = line.project(point)
    ends = shapely.get_coordinates(line.interpolate([max(0.0, s - 0.5), min(line.length, s + 0.5)]))
    along = ends[1] - ends[0]
    return np.asarray(along / max(float(np.hypot(*along)), 1e-9))
