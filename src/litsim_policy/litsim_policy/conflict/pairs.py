"""Compiled loops over pairs of agents: who is near whom, who follows whom, and whose boxes may overlap when."""

from __future__ import annotations

import math

import numpy as np

from litsim_policy.conflict.futures import HIGH_X, HIGH_Y, LOW_X, LOW_Y, SPREAD, XX, XY, YAW, YY, X, Y
from litsim_policy.conflict.overlap import likely
from litsim_sim.core.compiled import (
    BOOLS,
    BOOLS2,
    FLOATS,
    FLOATS2,
    FLOATS3,
    INTS,
    INTS2,
    OUT_BOOLS,
    OUT_FLOATS2,
    OUT_INTS2,
    boolean,
    float64,
    int64,
    kernel,
)
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray

FOLLOWED = 0.8  # of the distance at which boxes in line touch: closer, nobody follows anybody


@kernel(OUT_INTS2(INTS, FLOATS, FLOATS, BOOLS, BOOLS, float64))
def near(scene: IntArray, x: FloatArray, y: FloatArray, of: BoolArray, others: BoolArray, radius: float) -> IntArray:
    """Return pairs (m, 2) of positions in one scene, first of the mask `of` (n,), second of `others`, within `radius`.

    The radius is in metres.
    """
    count, found = 0, np.empty((of.sum() * others.sum(), 2), np.int64)
    for i in range(len(x)):
        if of[i]:
            for j in range(len(x)):
                if not others[j] or i == j or scene[j] != scene[i]:
                    continue
                if (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 <= radius**2:
                    found[count, 0], found[count, 1] = i, j
                    count += 1
    return found[:count].copy()


@kernel(OUT_BOOLS(INTS2, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS))
def followed(
    pairs: IntArray, x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray
) -> BoolArray:
    """Return for each of `pairs` (m, 2) whether the first is ahead in the strip that the second sweeps straight on.

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
        found[k] = ahead > FOLLOWED * clear and abs(left) < beside
    return found


@kernel(boolean(FLOATS2, FLOATS2, int64, int64, float64, float64))
def may_meet(bounds_a: FloatArray, bounds_b: FloatArray, i: int, j: int, reach: float, tail: float) -> bool:
    """Whether agent `i` of futures a and `j` of futures b are ever nearer than `reach` [m] and `tail` spreads each."""
    apart = reach + tail * (bounds_a[i, SPREAD] + bounds_b[j, SPREAD])
    return (
        bounds_a[i, LOW_X] <= bounds_b[j, HIGH_X] + apart
        and bounds_b[j, LOW_X] <= bounds_a[i, HIGH_X] + apart
        and bounds_a[i, LOW_Y] <= bounds_b[j, HIGH_Y] + apart
        and bounds_b[j, LOW_Y] <= bounds_a[i, HIGH_Y] + apart
    )


@kernel(
    OUT_FLOATS2(INTS2, FLOATS3, BOOLS2, FLOATS2, FLOATS3, BOOLS2, FLOATS2, FLOATS, FLOATS, float64, float64, boolean)
)
def overlap_chances(  # noqa: PLR0917 - a kernel takes arrays and numbers
    pairs: IntArray,
    states_a: FloatArray,
    valid_a: BoolArray,
    bounds_a: FloatArray,
    states_b: FloatArray,
    valid_b: BoolArray,
    bounds_b: FloatArray,
    length: FloatArray,
    width: FloatArray,
    least: float,
    quantile: float,
    first: bool,
) -> FloatArray:
    """Return the probability (m, T) that the boxes of each pair overlap, where it is at least `least`; else 0.

    Three tests of growing cost decide where it cannot be: the bounds of both futures, circles around the boxes at each
    step, and each strip of the boxes alone.

    Args:
        pairs: (m, 2) positions of an agent in futures a and of one in futures b.
        states_a, valid_a, bounds_a: (n, T, 6), (n, T), (n, 5) of a; see
            :class:`litsim_policy.conflict.futures.PredictedMotion`.
        states_b, valid_b, bounds_b: of b.
        length, width: (n,) of the boxes [m].
        least: probability that matters.
        quantile: of the standard Gaussian, for `least`.
        first: of each pair, only what comes up to the first step at which it matters.
    """
    steps = states_a.shape[1]
    found, tail = np.zeros((len(pairs), steps)), max(0.0, -quantile)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        reach = 0.5 * (math.hypot(length[i], width[i]) + math.hypot(length[j], width[j]))
        if not may_meet(bounds_a, bounds_b, i, j, reach, tail):
            continue
        for t in range(steps):
            if not (valid_a[i, t] and valid_b[j, t]):
                continue
            a, b = states_a[i, t], states_b[j, t]
            dx, dy = b[X] - a[X], b[Y] - a[Y]
            apart = reach + tail * (math.sqrt(a[XX] + a[YY]) + math.sqrt(b[XX] + b[YY]))
            if dx**2 + dy**2 >= apart**2:
                continue
            found[k, t] = likely(
                dx,
                dy,
                a[YAW],
                b[YAW],
                length[i],
                width[i],
                length[j],
                width[j],
                a[XX] + b[XX],
                a[YY] + b[YY],
                a[XY] + b[XY],
                least,
                quantile,
            )
            if first and found[k, t] > 0.0:
                break
    return found
