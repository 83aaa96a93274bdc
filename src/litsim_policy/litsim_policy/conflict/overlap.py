"""Whether the boxes of two agents overlap, and with which probability: at an instant, and step by step of two futures.

Two boxes overlap where the vector from one centre to the other lies in the Minkowski sum of both, which for rectangles
is the intersection of four strips |normal . distance| < half: one for each edge direction, as in the separating-axis
test. Each strip alone bounds the probability from above, which makes the broad phase cheap.

An uncertain motion is a Gaussian at each step. An agent with several possible motions is a mixture of them: its overlap
probability is the weighted mean of theirs.
"""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist

import numpy as np

from litsim_policy.conflict.futures import Boxes, gone_straight_on
from litsim_policy.conflict.predicted_motion import XX, XY, YAW, YY, PredictedMotion, X, Y
from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import STEP_S, FloatArray, IntArray
from litsim_sim.kernels.compiled import Bools, Bools2, Floats, Floats2, Floats3, Ints, Ints2, OutFloats, kernel

NEGLIGIBLE = 1e-3
"""Probability of an overlap below which a motion adds nothing to a weighted sum."""
NODES = 16  # number of nodes of the quadrature
REACH = 6.0  # standard deviations to either side over which the Gaussian is integrated
SIGMA_MIN = 1e-3  # [m] lower bound on standard deviations
FLAT = 1e-9  # lower bound on the dependence of a strip on a coordinate, by which it is divided

_NODE, _WEIGHT = np.polynomial.legendre.leggauss(NODES)
_ROOT_HALF = math.sqrt(0.5)
_ROOT_TWO_PI = math.sqrt(2.0 * math.pi)

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Motions = tuple[Floats3, Bools2]  # states and validity of a `PredictedMotion`


@kernel
def strips(
    yaw_a: float, yaw_b: float, length_a: float, width_a: float, length_b: float, width_b: float
) -> tuple[Four, Four, Four, Four]:
    """Return the strips of two boxes a and b: along a, left of a, along b, left of b.

    Args:
        yaw_a, yaw_b: headings [rad].
        length_a, width_a, length_b, width_b: extents [m].

    Returns:
        x of the unit normals, y of them, the half extents of the boxes that lie along them [m], and the half widths of
        the strips [m].
    """
    cos_a, sin_a, cos_b, sin_b = math.cos(yaw_a), math.sin(yaw_a), math.cos(yaw_b), math.sin(yaw_b)
    cos, sin = abs(cos_a * cos_b + sin_a * sin_b), abs(sin_a * cos_b - cos_a * sin_b)
    la, wa, lb, wb = 0.5 * length_a, 0.5 * width_a, 0.5 * length_b, 0.5 * width_b
    along_a, left_a = la + lb * cos + wb * sin, wa + lb * sin + wb * cos
    along_b, left_b = lb + la * cos + wa * sin, wb + la * sin + wa * cos
    normal_x, normal_y = (cos_a, -sin_a, cos_b, -sin_b), (sin_a, cos_a, sin_b, cos_b)
    return normal_x, normal_y, (la, wa, lb, wb), (along_a, left_a, along_b, left_b)


@kernel
def can_reach(
    normal_x: Four, normal_y: Four, half: Four, dx: float, dy: float, covariance: Three, quantile: float
) -> bool:
    """Whether each strip alone holds at least the required share of the Gaussian around (dx, dy) [m].

    The covariance is xx, yy, xy [m2], `quantile` that of the standard Gaussian for the required probability.
    """
    xx, yy, xy = covariance
    for k in range(4):
        variance = normal_x[k] ** 2 * xx + normal_y[k] ** 2 * yy + 2.0 * normal_x[k] * normal_y[k] * xy
        beyond = abs(normal_x[k] * dx + normal_y[k] * dy) - half[k]
        if not beyond < -quantile * math.sqrt(max(variance, 0.0)):
            return False
    return True


@kernel
def normal_below(value: float) -> float:
    """Return the probability that a standard Gaussian is below `value`."""
    return 0.5 * math.erfc(-value * _ROOT_HALF)


@kernel
def cut(middle: float, half: float, by_u: float, by_v: float) -> Three:
    """Return the section at u of a strip |middle + by_u u + by_v v| < half, as |offset + slope u + v| < width.

    Returns:
        offset, slope, width.
    """
    steep = 1.0 / max(abs(by_v), FLAT)
    signed = -steep if by_v < 0.0 else steep
    return signed * middle, signed * by_u, half * steep


@kernel
def probability_within(
    normal_x: Four, normal_y: Four, edge: Four, half: Four, dx: float, dy: float, covariance: Three
) -> float:
    """Return the probability that two boxes overlap if their distance is Gaussian.

    In the principal axes u, v of the covariance, scaled by its standard deviations, the Gaussian is standard and the
    region is a polygon. Its probability is the integral over u of phi(u) [Phi(v2(u)) - Phi(v1(u))], where (v1, v2) is
    the section of the polygon at u: Gauss-Legendre over u, exact along v. With u along the minor axis the section
    changes gently, except where an edge is nearly perpendicular to u; that is an end of the interval of integration.
    The error is below 0.02 (see the test against Monte Carlo), and nearly zero if the boxes are aligned with the
    principal axes, as in a lane.

    Args:
        normal_x, normal_y, edge, half: of :func:`strips`.
        dx, dy: mean distance, centre of b minus centre of a, frame map [m].
        covariance: of the distance: xx, yy, xy [m2].
    """
    xx, yy, xy = covariance
    turn = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi  # direction of the minor axis
    cos, sin = math.cos(turn), math.sin(turn)
    sigma_u = math.sqrt(max(cos**2 * xx + sin**2 * yy + 2.0 * cos * sin * xy, SIGMA_MIN**2))
    sigma_v = math.sqrt(max(sin**2 * xx + cos**2 * yy - 2.0 * cos * sin * xy, SIGMA_MIN**2))
    offset, slope, width, extent = np.empty(4), np.empty(4), np.empty(4), 0.0
    low, high = -REACH, REACH
    for k in range(4):
        along, across = normal_x[k] * cos + normal_y[k] * sin, normal_y[k] * cos - normal_x[k] * sin
        middle = normal_x[k] * dx + normal_y[k] * dy
        offset[k], slope[k], width[k] = cut(middle, half[k], sigma_u * along, sigma_v * across)
        extent += edge[k] * abs(along)
        if abs(slope[k]) > FLAT:  # beyond these u the strip is farther than REACH along v
            nearest, reach = -offset[k] / slope[k], (width[k] + REACH) / abs(slope[k])
            low, high = max(low, nearest - reach), min(high, nearest + reach)
    mean_u = dx * cos + dy * sin
    low, high = max(low, (-extent - mean_u) / sigma_u), min(high, (extent - mean_u) / sigma_u)
    if low >= high:
        return 0.0
    total = 0.0
    for node in range(NODES):
        u = 0.5 * (high + low) + 0.5 * (high - low) * _NODE[node]
        v_low, v_high = -math.inf, math.inf
        for k in range(4):
            centre = -(offset[k] + slope[k] * u)
            v_low, v_high = max(v_low, centre - width[k]), min(v_high, centre + width[k])
        if v_low < v_high:
            total += _WEIGHT[node] * (normal_below(v_high) - normal_below(v_low)) * math.exp(-0.5 * u**2)
    return 0.5 * (high - low) * total / _ROOT_TWO_PI


@kernel
def overlap_probability(
    dx: float, dy: float, yaw_a: float, yaw_b: float, sizes: Four, covariance: Three, least: float, quantile: float
) -> float:
    """Return the probability that two boxes overlap, where it is at least `least`; else 0.

    `dx`, `dy` are the mean distance, centre of b minus centre of a [m], and its covariance xx, yy, xy [m2]; without
    variance, it is certain. `sizes` are length and width of a, and of b [m], and `quantile` is that of the standard
    Gaussian for `least`.
    """
    length_a, width_a, length_b, width_b = sizes
    if covariance[0] + covariance[1] <= 0.0:
        return 1.0 if overlap(dx, dy, yaw_a, yaw_b, length_a, width_a, length_b, width_b) else 0.0
    normal_x, normal_y, edge, half = strips(yaw_a, yaw_b, length_a, width_a, length_b, width_b)
    if not can_reach(normal_x, normal_y, half, dx, dy, covariance, quantile):
        return 0.0
    probability = probability_within(normal_x, normal_y, edge, half, dx, dy, covariance)
    return probability if probability >= least else 0.0


@kernel
def touching(length_a: float, width_a: float, length_b: float, width_b: float) -> float:
    """Distance [m] of the centres of two boxes beyond which they cannot overlap, whatever their headings."""
    return 0.5 * (math.hypot(length_a, width_a) + math.hypot(length_b, width_b))


@kernel
def write_overlaps(  # noqa: PLR0917 - a kernel takes arrays and numbers
    a: Floats2,
    valid_a: Bools,
    b: Floats2,
    valid_b: Bools,
    sizes: Four,
    least: float,
    quantile: float,
    first: bool,
    probability: OutFloats,
) -> bool:
    """Write the `probability` (T,) that two boxes overlap where it is at least `least`; return whether it is anywhere.

    Steps at which it cannot be are excluded first by circles around the boxes, then by each strip of the boxes
    alone. States are (T, 6), see :class:`PredictedMotion`, sizes length and width of a, and of b [m], and
    `quantile` is that of the standard Gaussian for `least`. If `first`, it stops at the first step that reaches it.
    """
    reach = touching(sizes[0], sizes[1], sizes[2], sizes[3])
    matters, tail = False, max(0.0, -quantile)
    for t in range(len(probability)):
        if not (valid_a[t] and valid_b[t]):
            continue
        dx, dy = b[t, X] - a[t, X], b[t, Y] - a[t, Y]
        apart = reach + tail * (math.sqrt(a[t, XX] + a[t, YY]) + math.sqrt(b[t, XX] + b[t, YY]))
        if dx**2 + dy**2 >= apart**2:
            continue
        covariance = a[t, XX] + b[t, XX], a[t, YY] + b[t, YY], a[t, XY] + b[t, XY]
        probability[t] = overlap_probability(dx, dy, a[t, YAW], b[t, YAW], sizes, covariance, least, quantile)
        matters = matters or probability[t] > 0.0
        if first and matters:
            break
    return matters


@kernel
def closing_overlaps(pairs: Ints2, motions: Motions, boxes: Boxes, first: bool) -> Floats2:
    """Return an array (m, T): 1 where boxes overlap if the second continues straight on for its `time`; else 0.

    The first of each pair moves by `motions`, states (n, T, 6) without any spread and validity (n, T); the second
    keeps its acceleration until it stands. `first` is as in :func:`mixture_overlap_probability`.
    """
    (states, valid), length, width = motions, boxes.length, boxes.width
    overlaps, done = np.zeros((len(pairs), states.shape[1])), -1
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        if first and i == done:
            continue
        reach = touching(length[i], width[i], length[j], width[j])
        cos, sin = math.cos(boxes.yaw[j]), math.sin(boxes.yaw[j])
        for t in range(min(round(boxes.time[j] / STEP_S), states.shape[1])):
            if not valid[i, t]:
                continue
            gone = gone_straight_on(boxes.speed[j], boxes.acceleration[j], (t + 1) * STEP_S)
            dx, dy = boxes.x[j] + gone * cos - states[i, t, X], boxes.y[j] + gone * sin - states[i, t, Y]
            if dx**2 + dy**2 >= reach**2:
                continue
            if overlap(dx, dy, states[i, t, YAW], boxes.yaw[j], length[i], width[i], length[j], width[j]):
                overlaps[k, t], done = 1.0, i
                if first:
                    break
    return overlaps


@cache
def quantile(probability: float) -> float:
    """Returns the quantile of the standard Gaussian for a probability; infinite for 0 and 1."""
    within = 0.0 < probability < 1.0  # without scipy, the import of which takes as long as all kernels of the launcher
    return NormalDist().inv_cdf(probability) if within else math.copysign(math.inf, probability - 0.5)


def mixture_overlap_probability(
    pairs: IntArray,
    a: PredictedMotion,
    b: PredictedMotion,
    sizes: tuple[FloatArray, FloatArray],
    least: float,
    *,
    first: bool = False,
) -> FloatArray:
    """Probability (m, T) that the boxes of each pair overlap, over all motions of b; 0 where it does not reach `least`.

    A weighted mean reaches `least` only where one of its terms does. So each motion is first compared with that
    bound, which is cheap, and all motions are integrated only for pairs of which one reaches it. Agents in `a` have
    one known motion; sizes are lengths and widths (n,) [m].

    If `first`, one pair of each agent in `a` is enough that reaches `least` at one step. All later pairs of that
    agent, which stand together, are then 0, and so are later steps, except of pairs with several motions.
    """
    further = b.alternatives
    return _mixture_overlaps(
        pairs,
        (a.states, a.valid),
        (b.states, b.valid),
        (further.states, further.valid),
        (further.row, further.weight),
        sizes,
        (least, quantile(least), quantile(NEGLIGIBLE)),
        first,
    )


@kernel
def by_agent(row: Ints, count: int) -> tuple[Ints, Ints]:
    """Return the order (q,) of alternative motions by their agent `row` (q,), and where each of `count` agents begins.

    The beginnings are (n + 1,), the last of them q. Motions of an agent stay in their order.
    """
    begin, order = np.zeros(count + 1, np.int64), np.empty(len(row), np.int64)
    for q in range(len(row)):
        begin[row[q] + 1] += 1
    for agent in range(count):
        begin[agent + 1] += begin[agent]
    end = begin.copy()  # of the motions that have their places
    for q in range(len(row)):
        order[end[row[q]]] = q
        end[row[q]] += 1
    return order, begin


@kernel
def _drop_below(probability: OutFloats, least: float) -> bool:
    """Replace those of `probability` (T,) that do not reach `least` by 0; return whether any does."""
    reached = False
    for t in range(len(probability)):
        if probability[t] < least:
            probability[t] = 0.0
        else:
            reached = True
    return reached


@kernel
def _mixture_overlaps(
    pairs: Ints2,
    a: Motions,
    b: Motions,
    further: Motions,
    mixture: tuple[Ints, Floats],
    sizes: tuple[Floats, Floats],
    limits: Three,
    first: bool,
) -> Floats2:
    """See :func:`mixture_overlap_probability`; `further` are the alternative motions of b.

    `mixture` are their agents' rows and weights, and `limits` `least`, and the quantiles of the standard Gaussian
    for it and for NEGLIGIBLE.
    """
    (states_a, valid_a), (states_b, valid_b), (states, valid) = a, b, further
    length, width = sizes
    least, least_quantile, negligible_quantile = limits
    (row, weight), taken = mixture, np.zeros(len(states_b))
    order, begin = by_agent(row, len(states_b))
    for q in range(len(row)):
        taken[row[q]] += weight[q]
    probability, of_motion, done = np.zeros((len(pairs), states_a.shape[1])), np.empty(states_a.shape[1]), -1
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        if first and i == done:
            continue
        own, is_valid, boxes = states_a[i], valid_a[i], (length[i], width[i], length[j], width[j])
        if begin[j] == begin[j + 1]:
            if write_overlaps(
                own, is_valid, states_b[j], valid_b[j], boxes, least, least_quantile, first, probability[k]
            ):
                done = i
            continue
        matters = False
        for weighing in (False, True):  # until one motion matters; if one does, all
            bound, quantile_of_bound = (NEGLIGIBLE, negligible_quantile) if weighing else (least, least_quantile)
            for m in range(1 + begin[j + 1] - begin[j]):  # the first motion of the agent, then its alternatives
                if weighing != matters:
                    break
                other, other_is_valid, share = states_b[j], valid_b[j], 1.0 - taken[j]
                if m:
                    q = order[begin[j] + m - 1]
                    other, other_is_valid, share = states[q], valid[q], weight[q]
                of_motion[:] = 0.0
                reached = write_overlaps(
                    own, is_valid, other, other_is_valid, boxes, bound, quantile_of_bound, not weighing, of_motion
                )
                matters = matters or reached
                if weighing:
                    probability[k] += share * of_motion
        if _drop_below(probability[k], least):
            done = i
    return probability
