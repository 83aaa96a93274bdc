"""Oriented boxes in the plane and the small frame changes around them. Everything is vectorised.

A box is (x, y, yaw, length, width): centre in frame map [m], heading [rad], extents [m].
"""

from __future__ import annotations

from typing import cast

import numpy as np

from litsim_sim.core.scene import BoolArray, FloatArray, IntArray


def wrap_angle(angle: FloatArray) -> FloatArray:
    """The same angles [rad] within [-pi, pi); any shape."""
    wrapped = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return cast(FloatArray, np.where(wrapped < np.pi, wrapped, -np.pi))  # the remainder can round up to a full turn


def box_corners(x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray) -> FloatArray:
    """The corners (..., 4, 2) [m] of boxes given as arrays (...), counter-clockwise from the front left."""
    cos, sin = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    along = 0.5 * length[..., None] * np.array([1.0, -1.0, -1.0, 1.0])
    across = 0.5 * width[..., None] * np.array([1.0, 1.0, -1.0, -1.0])
    return np.stack([x[..., None] + cos * along - sin * across, y[..., None] + sin * along + cos * across], axis=-1)


def boxes_overlap(
    dx: FloatArray,
    dy: FloatArray,
    yaw_a: FloatArray,
    yaw_b: FloatArray,
    size_a: tuple[FloatArray, FloatArray],
    size_b: tuple[FloatArray, FloatArray],
) -> BoolArray:
    """Whether boxes a and b share interior points; separating-axis test, touching edges do not count.

    Args:
        dx, dy: (...) centre of b minus centre of a [m].
        yaw_a, yaw_b: (...) headings [rad].
        size_a, size_b: lengths and widths, broadcastable to (...) [m].
    """
    cos_a, sin_a, cos_b, sin_b = np.cos(yaw_a), np.sin(yaw_a), np.cos(yaw_b), np.sin(yaw_b)
    half_la, half_wa, half_lb, half_wb = 0.5 * size_a[0], 0.5 * size_a[1], 0.5 * size_b[0], 0.5 * size_b[1]
    cos = np.abs(cos_a * cos_b + sin_a * sin_b)
    sin = np.abs(sin_a * cos_b - cos_a * sin_b)
    apart = np.abs(dx * cos_a + dy * sin_a) >= half_la + half_lb * cos + half_wb * sin
    apart |= np.abs(dy * cos_a - dx * sin_a) >= half_wa + half_lb * sin + half_wb * cos
    apart |= np.abs(dx * cos_b + dy * sin_b) >= half_lb + half_la * cos + half_wa * sin
    apart |= np.abs(dy * cos_b - dx * sin_b) >= half_wb + half_la * sin + half_wa * cos
    return cast(BoolArray, ~apart)


def overlapping_pairs(x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray) -> IntArray:
    """Pairs (m, 2) of positions i < j whose boxes overlap, among boxes (n,)."""
    reach = 0.5 * np.hypot(length, width)
    order = np.argsort(x, kind="stable")
    x_sorted, reach_max = x[order], float(reach.max(initial=0.0))
    last = np.searchsorted(x_sorted, x_sorted + 2.0 * reach_max, side="right")
    count = last - np.arange(len(x)) - 1
    if not count.sum():
        return np.empty((0, 2), np.int64)
    first = np.repeat(np.arange(len(x)), count)
    second = first + 1 + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    a, b = order[first], order[second]
    near = np.hypot(x[b] - x[a], y[b] - y[a]) < reach[a] + reach[b]
    a, b = a[near], b[near]
    hit = boxes_overlap(x[b] - x[a], y[b] - y[a], yaw[a], yaw[b], (length[a], width[a]), (length[b], width[b]))
    pairs = np.sort(np.stack([a[hit], b[hit]], axis=1), axis=1)
    return cast(IntArray, pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def to_body(dx: FloatArray, dy: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Displacements in frame map expressed ahead of and to the left of a body with heading `yaw`."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return dx * cos + dy * sin, dy * cos - dx * sin
