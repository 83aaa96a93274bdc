"""Compiled loops over pairs of agents: which are near each other, and which merely follow one another."""

from __future__ import annotations

import math

import numpy as np

from litsim_sim.core.pair_geometry import behind_scene
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    BOOLS,
    FLOATS,
    INTS,
    INTS2,
    OUT_BOOLS,
    OUT_INTS2,
    boolean,
    float64,
    kernel,
)

FOLLOWED = 0.8  # of the distance at which boxes in line touch: closer pairs do not follow each other


@kernel(boolean(float64, float64, float64, float64, float64, float64))
def in_region(dx: float, dy: float, faster_x: float, faster_y: float, radius: float, time: float) -> bool:
    """Whether an agent is within `radius` [m], or will be within `time` [s] at its present rate of approach.

    Args:
        dx, dy: its position relative to the observer [m].
        faster_x, faster_y: its velocity relative to the observer [m/s].
        radius, time: of the region.
    """
    square = dx * dx + dy * dy
    if square <= radius * radius:
        return True
    nearer = -(dx * faster_x + dy * faster_y) * time  # both sides of the comparison are multiplied by the distance
    return square - math.sqrt(square) * radius <= nearer


@kernel(OUT_INTS2(INTS, *[FLOATS] * 4, BOOLS, BOOLS, float64, float64))
def near(  # noqa: PLR0917 - a kernel takes arrays and numbers
    scene: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    of: BoolArray,
    others: BoolArray,
    radius: float,
    time: float,
) -> IntArray:
    """Return pairs (m, 2) of positions in one scene, first of the mask `of` (n,), second of `others`.

    They are :func:`in_region` of each other.

    Args:
        scene, x, y, yaw, speed: (n,) of all agents.
        of, others: masks (n,).
        radius, time: of the region [m], [s].
    """
    count, found = 0, np.empty((of.sum() * others.sum(), 2), np.int64)
    begin, end = 0, 0
    vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
    for i in range(len(x)):
        if i == end:
            begin, end = i, behind_scene(scene, i)
        if of[i]:
            for j in range(begin, end):
                if not others[j] or i == j:
                    continue
                if in_region(x[j] - x[i], y[j] - y[i], vx[j] - vx[i], vy[j] - vy[i], radius, time):
                    found[count, 0], found[count, 1] = i, j
                    count += 1
    return found[:count].copy()


@kernel(OUT_BOOLS(INTS, *[FLOATS] * 4, BOOLS, float64, float64))
def near_any(
    scene: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    of: BoolArray,
    radius: float,
    time: float,
) -> BoolArray:
    """Return the mask (n,) of agents that are :func:`near` one in the mask `of` (n,), these included."""
    found, begin, end = of.copy(), 0, 0
    vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
    for i in range(len(x)):
        if i == end:
            begin, end = i, behind_scene(scene, i)
        if of[i]:
            for j in range(begin, end):
                if not found[j]:
                    found[j] = in_region(x[j] - x[i], y[j] - y[i], vx[j] - vx[i], vy[j] - vy[i], radius, time)
    return found


@kernel(OUT_BOOLS(INTS2, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS))
def followed(
    pairs: IntArray, x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray
) -> BoolArray:
    """Return for each of `pairs` (m, 2) whether the second follows the first.

    The first is ahead in the strip that the second sweeps straight on, with headings within a quarter turn: an oncoming
    agent is not a leader.

    Args:
        pairs: positions of agents.
        x, y, yaw, length, width: (n,) of all agents [m], [rad].
    """
    found = np.empty(len(pairs), np.bool_)
    for k in range(len(pairs)):
        leader, follower = pairs[k, 0], pairs[k, 1]
        dx, dy = x[leader] - x[follower], y[leader] - y[follower]
        cos, sin = math.cos(yaw[follower]), math.sin(yaw[follower])
        ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
        clear = 0.5 * (length[leader] + length[follower])
        beside = 0.5 * (width[leader] + width[follower])
        same_way = math.cos(yaw[leader] - yaw[follower]) > 0.0
        found[k] = same_way and ahead > FOLLOWED * clear and abs(left) < beside
    return found
