"""Probabilities that the boxes of pairs of agents overlap, step by step of their futures; compiled loops."""

from __future__ import annotations

import math

import numpy as np

from litsim_policy.conflict.futures import (
    HIGH_X,
    HIGH_Y,
    LOW_X,
    LOW_Y,
    SPREAD,
    XX,
    XY,
    YAW,
    YY,
    X,
    Y,
    gone_straight_on,
)
from litsim_policy.conflict.overlap import contain, likely, strips
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    BOOLS,
    BOOLS2,
    FLOATS,
    FLOATS2,
    FLOATS3,
    INTS2,
    OUT_BOOLS,
    OUT_FLOATS,
    OUT_FLOATS2,
    boolean,
    float64,
    int64,
    kernel,
)


@kernel(float64(*[float64] * 4))
def touching(length_a: float, width_a: float, length_b: float, width_b: float) -> float:
    """Distance [m] of the centres of two boxes beyond which they cannot overlap, whatever their headings."""
    return 0.5 * (math.hypot(length_a, width_a) + math.hypot(length_b, width_b))


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


@kernel(OUT_BOOLS(INTS2, FLOATS2, FLOATS2, FLOATS, FLOATS, float64))
def within_bounds(
    pairs: IntArray, bounds_a: FloatArray, bounds_b: FloatArray, length: FloatArray, width: FloatArray, tail: float
) -> BoolArray:
    """Return for each of `pairs` (m, 2) whether its boxes can overlap at all, by the bounds of futures a and b.

    Args:
        pairs: positions of an agent in futures a and of one in futures b.
        bounds_a, bounds_b: (n, 5) as in :class:`litsim_policy.conflict.futures.PredictedMotion`.
        length, width: (n,) of the boxes [m].
        tail: number of spreads by which the centres may deviate from their means.
    """
    found = np.empty(len(pairs), np.bool_)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        reach = touching(length[i], width[i], length[j], width[j])
        found[k] = may_meet(bounds_a, bounds_b, i, j, reach, tail)
    return found


@kernel(boolean(FLOATS2, BOOLS, FLOATS2, BOOLS, *[float64] * 6, boolean, OUT_FLOATS))
def write_chances(  # noqa: PLR0917 - a kernel takes arrays and numbers
    a: FloatArray,
    valid_a: BoolArray,
    b: FloatArray,
    valid_b: BoolArray,
    length_a: float,
    width_a: float,
    length_b: float,
    width_b: float,
    least: float,
    quantile: float,
    first: bool,
    found: FloatArray,
) -> bool:
    """Write into `found` (T,) the probability that two boxes overlap, where it is at least `least`.

    Steps at which it cannot be are excluded first by circles around the boxes, then by each strip of the boxes alone.

    Args:
        a, valid_a: (T, 6), (T,) of one agent; see :class:`litsim_policy.conflict.futures.PredictedMotion`.
        b, valid_b: of the other.
        length_a, width_a, length_b, width_b: of the boxes [m].
        least: least probability that is computed.
        quantile: of the standard Gaussian, for `least`.
        first: whether to stop at the first step that reaches `least`.
        found: zeros.

    Returns:
        whether the probability reaches `least` at any step.
    """
    reach = touching(length_a, width_a, length_b, width_b)
    matters, tail = False, max(0.0, -quantile)
    for t in range(len(found)):
        if not (valid_a[t] and valid_b[t]):
            continue
        dx, dy = b[t, X] - a[t, X], b[t, Y] - a[t, Y]
        apart = reach + tail * (math.sqrt(a[t, XX] + a[t, YY]) + math.sqrt(b[t, XX] + b[t, YY]))
        if dx**2 + dy**2 >= apart**2:
            continue
        found[t] = likely(
            dx,
            dy,
            a[t, YAW],
            b[t, YAW],
            length_a,
            width_a,
            length_b,
            width_b,
            a[t, XX] + b[t, XX],
            a[t, YY] + b[t, YY],
            a[t, XY] + b[t, XY],
            least,
            quantile,
        )
        matters = matters or found[t] > 0.0
        if first and matters:
            break
    return matters


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

    The bounds of both futures are compared first, which is cheap, and then each step by :func:`write_chances`.

    Args:
        pairs: (m, 2) positions of an agent in futures a and of one in futures b.
        states_a, valid_a, bounds_a: (n, T, 6), (n, T), (n, 5) of a; see
            :class:`litsim_policy.conflict.futures.PredictedMotion`.
        states_b, valid_b, bounds_b: of b.
        length, width: (n,) of the boxes [m].
        least: least probability that is computed.
        quantile: of the standard Gaussian, for `least`.
        first: whether to stop, for each pair, at the first step that reaches `least`.
    """
    found, tail = np.zeros((len(pairs), states_a.shape[1])), max(0.0, -quantile)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        reach = touching(length[i], width[i], length[j], width[j])
        if may_meet(bounds_a, bounds_b, i, j, reach, tail):
            write_chances(
                states_a[i],
                valid_a[i],
                states_b[j],
                valid_b[j],
                length[i],
                width[i],
                length[j],
                width[j],
                least,
                quantile,
                first,
                found[k],
            )
    return found


@kernel(OUT_FLOATS2(INTS2, FLOATS3, BOOLS2, *[FLOATS] * 8))
def closing_chances(  # noqa: PLR0917 - a kernel takes arrays and numbers
    pairs: IntArray,
    states: FloatArray,
    valid: BoolArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    length: FloatArray,
    width: FloatArray,
    time: FloatArray,
) -> FloatArray:
    """Return an array (m, T): 1 where boxes overlap if the second continues straight on for its `time`; else 0.

    Args:
        pairs: (m, 2) of an agent that moves by `states`, and of one that keeps its acceleration until it stands.
        states, valid: (n, T, 6), (n, T), without any spread.
        x, y, yaw, speed, acceleration: (n,) now [m], [rad], [m/s], [m/s2].
        length, width: (n,) of the boxes [m].
        time: (n,) for which agents continue [s].
    """
    found = np.zeros((len(pairs), states.shape[1]))
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        reach = touching(length[i], width[i], length[j], width[j])
        cos, sin = math.cos(yaw[j]), math.sin(yaw[j])
        for t in range(min(round(time[j] / STEP_S), states.shape[1])):
            if not valid[i, t]:
                continue
            gone = gone_straight_on(speed[j], acceleration[j], (t + 1) * STEP_S)
            dx, dy = x[j] + gone * cos - states[i, t, X], y[j] + gone * sin - states[i, t, Y]
            if dx**2 + dy**2 >= reach**2:
                continue
            boxes = strips(states[i, t, YAW], yaw[j], length[i], width[i], length[j], width[j])
            found[k, t] = contain(boxes[0], boxes[1], boxes[3], dx, dy)
    return found
