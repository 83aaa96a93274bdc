"""Functions of :mod:`litsim_sim.core.geometry` for single pairs of boxes, to be called from compiled loops."""

from __future__ import annotations

import math

import numpy as np

from litsim_sim.kernels.compiled import Ints, kernel, outer


@kernel
def overlap(
    dx: float, dy: float, yaw_a: float, yaw_b: float, length_a: float, width_a: float, length_b: float, width_b: float
) -> bool:
    """Returns whether boxes a and b share interior points, like :func:`litsim_sim.core.geometry.boxes_overlap`.

    `dx`, `dy` are the centre of b minus that of a [m].
    """
    cos_a, sin_a, cos_b, sin_b = math.cos(yaw_a), math.sin(yaw_a), math.cos(yaw_b), math.sin(yaw_b)
    half_la, half_wa, half_lb, half_wb = 0.5 * length_a, 0.5 * width_a, 0.5 * length_b, 0.5 * width_b
    cos = abs(cos_a * cos_b + sin_a * sin_b)
    sin = abs(sin_a * cos_b - cos_a * sin_b)
    # without branches, which processors would guess wrongly
    apart = abs(dx * cos_a + dy * sin_a) >= half_la + half_lb * cos + half_wb * sin
    apart |= abs(dy * cos_a - dx * sin_a) >= half_wa + half_lb * sin + half_wb * cos
    apart |= abs(dx * cos_b + dy * sin_b) >= half_lb + half_la * cos + half_wa * sin
    apart |= abs(dy * cos_b - dx * sin_b) >= half_wb + half_la * sin + half_wa * cos
    return not apart


@kernel
def wrapped(angle: float) -> float:
    """Returns the same angle [rad] in [-pi, pi), like :func:`litsim_sim.core.geometry.wrap_angle`."""
    wrapped_angle = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped_angle if wrapped_angle < math.pi else -math.pi


@kernel
def within(value: float, low: float, high: float) -> float:
    """Returns `value` clipped to [`low`, `high`], like :func:`numpy.clip` with arrays of bounds.

    The result is `high` if `low` is above it. If `value` equals a bound, the result is the bound: zeros have signs, on
    which digests of runs depend.
    """
    return min(high, max(low, value))  # min and max return the first of equal numbers


@kernel
def behind_scene(scene: Ints, row: int) -> int:
    """Returns the end row (exclusive) of the scene of the agent in `row`; `scene` (n,) as in :func:`within_scenes`."""
    return int(np.searchsorted(scene, scene[row], "right"))


@outer
@kernel
def within_scenes(scene: Ints, rows: Ints) -> tuple[Ints, Ints]:
    """Returns the first rows (m,) and end rows (m,), exclusive, of the scenes of the agents in `rows` (m,).

    `scene` (n,) are the scenes of all agents, ascending like their ids.
    """
    begin, end = np.empty(len(rows), np.int64), np.empty(len(rows), np.int64)
    for i in range(len(rows)):
        if i > 0 and scene[rows[i]] == scene[rows[i - 1]]:
            begin[i], end[i] = begin[i - 1], end[i - 1]
            continue
        begin[i] = np.searchsorted(scene, scene[rows[i]])
        end[i] = behind_scene(scene, rows[i])
    return begin, end
