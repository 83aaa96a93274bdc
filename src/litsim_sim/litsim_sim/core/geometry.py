"""Oriented boxes in the plane and the small frame changes around them. Everything is vectorised.

A box is (x, y, yaw, length, width): centre in frame map [m], heading [rad], extents [m].
"""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, Ints, Ints2, kernel


def wrap_angle(angle: FloatArray) -> FloatArray:
    """Returns the same angles [rad] within [-pi, pi); any shape."""
    wrapped = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return cast(FloatArray, np.where(wrapped < np.pi, wrapped, -np.pi))  # the remainder can round up to a full turn


def box_corners(x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray) -> FloatArray:
    """Returns the corners (..., 4, 2) [m] of boxes given as arrays (...), counter-clockwise from the front left."""
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
    """Returns whether boxes a and b share interior points; separating-axis test, touching edges do not count.

    `dx`, `dy` (...) are the centre of b minus that of a [m], sizes lengths and widths that broadcast to (...) [m].
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


def overlapping_pairs(
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    length: FloatArray,
    width: FloatArray,
    scene: IntArray | None = None,
) -> IntArray:
    """Returns pairs (m, 2) of indices i < j of boxes (n,) that overlap within a `scene` (n,); None for one scene."""
    order = x.argsort(kind="stable") if scene is None else np.lexsort((x, scene))
    scene = np.zeros(len(x), np.int64) if scene is None else scene
    x, y, yaw, length, width = (np.ascontiguousarray(v, np.float64) for v in (x, y, yaw, length, width))
    pairs = _overlapping(scene, x, y, yaw, length, width, order)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))] if len(pairs) > 1 else pairs


@kernel
def _overlapping(scene: Ints, x: Floats, y: Floats, yaw: Floats, length: Floats, width: Floats, order: Ints) -> Ints2:
    """Returns pairs (m, 2) of indices of overlapping boxes (n,), the lower index first.

    `order` (n,) sorts the boxes by scene, and by `x` within each.
    """
    reach = np.empty(len(x))
    for i in range(len(x)):
        reach[i] = 0.5 * math.hypot(length[i], width[i])
    farthest = 2.0 * reach.max() if len(x) else 0.0
    pairs, count = np.empty((8, 2), np.int64), 0
    for first in range(len(x)):
        a = order[first]
        for second in range(first + 1, len(x)):
            b = order[second]
            if scene[a] != scene[b] or x[b] > x[a] + farthest:
                break
            dx, dy = x[b] - x[a], y[b] - y[a]
            if not math.hypot(dx, dy) < reach[a] + reach[b]:
                continue
            if overlap(dx, dy, yaw[a], yaw[b], length[a], width[a], length[b], width[b]):
                if count == len(pairs):
                    pairs = np.concatenate((pairs, np.empty_like(pairs)))
                pairs[count, 0], pairs[count, 1] = min(a, b), max(a, b)
                count += 1
    return pairs[:count].copy()


def arc_lengths(points: FloatArray) -> FloatArray:
    """Returns the distances (m,) [m] along a polyline (m, 2) from its first point to each."""
    step = points[1:] - points[:-1]
    travelled = np.zeros(len(points))
    np.cumsum(np.hypot(step[:, 0], step[:, 1]), out=travelled[1:])
    return travelled


def shift_left(line: FloatArray, distance: FloatArray | float) -> FloatArray:
    """Returns the vertices of `line` (k, 2) moved to its left by `distance`, one for all or (k,) [m].

    At a bend a vertex is moved so far that both of its segments are at this distance, at most by 1.5 times as much.
    """
    step = line[1:] - line[:-1]
    across = np.column_stack([-step[:, 1], step[:, 0]]) / np.maximum(np.hypot(*step.T), 1e-9)[:, None]
    mean = np.concatenate([across[:1], 0.5 * (across[:-1] + across[1:]), across[-1:]])
    return line + np.reshape(distance, (-1, 1)) * (mean / np.maximum((mean**2).sum(axis=1), 0.5)[:, None])


def smooth_step(u: FloatArray | float) -> FloatArray:
    """Returns the quintic from 0 to 1 over `u` in [0, 1] whose first two derivatives vanish at both ends."""
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


def to_body(dx: FloatArray, dy: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Displacements in frame map expressed ahead of and to the left of a body with heading `yaw`."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return dx * cos + dy * sin, dy * cos - dx * sin
