"""Clouds of points, ``sensor_msgs/PointCloud2``: their layout, the points of agents, and reading. Without ROS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

DATATYPES = {"<f4": 7, "<f8": 8, "<u4": 6, "|u1": 2}  # of ``sensor_msgs/PointField``, by numpy's types
OBJECT = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "yaw", "speed", "vx", "vy", "length", "width")),
        ("id", "<u4"),
        ("kind", "u1"),
        ("padding", "V7"),
        *((name, "<f8") for name in ("x64", "y64")),
    ]
)
"""A point of /litsim/objects, see :func:`litsim_sim.ros.standard.objects`."""

_ID_MASK = 0xFFFFFFFF  # PointCloud2 has no 64-bit integers


def object_points(column: Callable[[str], np.ndarray], count: int) -> np.ndarray[Any, Any]:
    """Returns `count` agents as points; `column` returns the values (n,) of :class:`.AgentTable` by name."""
    points = np.zeros(count, OBJECT)
    for name in ("x", "y", "yaw", "speed", "length", "width", "kind"):
        points[name] = column(name)
    x, y, yaw, speed = (column(name) for name in ("x", "y", "yaw", "speed"))
    points["x64"], points["y64"], points["id"] = x, y, column("id").astype(np.int64) & _ID_MASK
    points["vx"], points["vy"] = speed * np.cos(yaw), speed * np.sin(yaw)
    return points


def fields_of(layout: np.dtype[Any]) -> list[tuple[str, int, int]]:
    """Returns name, offset and datatype of each field of a layout but padding."""
    fields = (layout.fields or {}).items()
    return [(name, offset, DATATYPES[kind.str]) for name, (kind, offset, *_) in fields if name != "padding"]


def cloud_columns(message: Any) -> np.ndarray[Any, Any]:
    """Returns the points (n,) of a ``sensor_msgs/PointCloud2``; raises ValueError if its fields do not fit."""
    layout = {field.name: (" bBhHiIfd"[field.datatype], field.offset) for field in message.fields}
    kinds, offsets = zip(*layout.values(), strict=True)
    described: Any = {"names": [*layout], "formats": kinds, "offsets": offsets, "itemsize": int(message.point_step)}
    return np.frombuffer(bytes(message.data), np.dtype(described))
