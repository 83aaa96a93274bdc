"""Overlap with agents that have several possible motions: the weighted mean of the probabilities."""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist

import numpy as np
from numba.types import Tuple

from litsim_policy.conflict.futures import PredictedMotion
from litsim_policy.conflict.overlap_over_time import may_meet, overlap_chances, touching, write_chances
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    BOOLS2,
    FLOATS,
    FLOATS2,
    FLOATS3,
    INTS,
    INTS2,
    OUT_FLOATS,
    OUT_FLOATS2,
    OUT_INTS,
    boolean,
    float64,
    int64,
    kernel,
)

NEGLIGIBLE = 1e-3
"""Probability of an overlap below which a motion adds nothing to a weighted sum."""
FIRST, NONE = -1, -2  # in place of the position of an alternative motion: the first motion, and no further one


def weighed_chances(
    pairs: IntArray,
    a: PredictedMotion,
    b: PredictedMotion,
    length: FloatArray,
    width: FloatArray,
    least: float,
    *,
    first: bool = False,
) -> FloatArray:
    """Probability (m, T) that the boxes of each pair overlap, over all motions of b; 0 where it does not reach `least`.

    A weighted mean reaches `least` only where one of its terms does. So each motion is first compared with that bound,
    which is cheap, and all motions are integrated only for pairs of which one reaches it.

    Args:
        pairs: (m, 2) of rows: an agent in `a`, with one known motion, and one in `b`.
        a, b: motions of the same n agents.
        length, width: (n,) of their boxes [m].
        least: least probability that is computed.
        first: whether to stop, for each pair, at the first step that reaches `least`; not for agents with several
            motions.
    """
    motions = a.states, a.valid, a.bounds, b.states, b.valid, b.bounds
    bound = length, width, least, quantile(least)
    others = b.others
    if not len(others):
        return overlap_chances(pairs, *motions, *bound, first)
    further = others.row, others.weight, others.states, others.valid, others.bounds
    return _weighed(pairs, *motions, *further, *bound, quantile(NEGLIGIBLE), first)


@cache
def quantile(probability: float) -> float:
    """Quantile of the standard Gaussian for a probability; infinite for 0 and 1."""
    within = 0.0 < probability < 1.0  # without scipy, the import of which takes as long as all kernels of the launcher
    return NormalDist().inv_cdf(probability) if within else math.copysign(math.inf, probability - 0.5)


@kernel(Tuple((OUT_INTS, OUT_INTS, OUT_FLOATS))(INTS, FLOATS, int64))
def _listed(row: IntArray, weight: FloatArray, count: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the alternative motions of n = `count` agents as linked lists.

    Args:
        row, weight: (q,) agent and weight of each motion.
        count: number of agents.

    Returns:
        the first alternative motion of each agent (n,), and the one that follows each motion (q,), or NONE; and the
        sum of each agent's weights (n,).
    """
    begin, following, taken = np.full(count, NONE), np.full(len(row), NONE), np.zeros(count)
    for q in range(len(row)):
        taken[row[q]] += weight[q]
    for q in range(len(row) - 1, -1, -1):
        begin[row[q]], following[q] = q, begin[row[q]]
    return begin, following, taken


@kernel(
    OUT_FLOATS2(
        INTS2,
        *(FLOATS3, BOOLS2, FLOATS2),
        *(FLOATS3, BOOLS2, FLOATS2),
        *(INTS, FLOATS, FLOATS3, BOOLS2, FLOATS2),
        *(FLOATS, FLOATS),
        *(float64, float64, float64, boolean),
    )
)
def _weighed(  # noqa: PLR0917 - a kernel takes arrays and numbers
    pairs: IntArray,
    states_a: FloatArray,
    valid_a: BoolArray,
    bounds_a: FloatArray,
    states_b: FloatArray,
    valid_b: BoolArray,
    bounds_b: FloatArray,
    row: IntArray,
    weight: FloatArray,
    states: FloatArray,
    valid: BoolArray,
    bounds: FloatArray,
    length: FloatArray,
    width: FloatArray,
    least: float,
    least_quantile: float,
    negligible_quantile: float,
    first: bool,
) -> FloatArray:
    """See :func:`weighed_chances`.

    Args:
        pairs, length, width, least, first: likewise.
        states_a, valid_a, bounds_a, states_b, valid_b, bounds_b: of :class:`.futures.PredictedMotion`.
        row, weight, states, valid, bounds: of :class:`.futures.OtherMotions`, the alternative motions of b.
        least_quantile, negligible_quantile: of the standard Gaussian, for `least` and for NEGLIGIBLE.
    """
    steps = states_a.shape[1]
    begin, following, taken = _listed(row, weight, len(states_b))
    found, chance = np.zeros((len(pairs), steps)), np.empty(steps)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        several, matters = begin[j] != NONE, False
        reach = touching(length[i], width[i], length[j], width[j])
        for weighing in (False, True):
            if weighing and not (several and matters):
                break
            motion = FIRST
            tail = max(0.0, -(negligible_quantile if weighing else least_quantile))
            while motion != NONE and (weighing or not matters):
                b, is_valid, share = states_b[j], valid_b[j], 1.0 - taken[j]
                meet = motion == FIRST and may_meet(bounds_a, bounds_b, i, j, reach, tail)
                if motion != FIRST:
                    b, is_valid, share = states[motion], valid[motion], weight[motion]
                    meet = may_meet(bounds_a, bounds, i, motion, reach, tail)
                motion = begin[j] if motion == FIRST else following[motion]
                if not meet:
                    continue
                chance[:] = 0.0
                reached = write_chances(
                    states_a[i],
                    valid_a[i],
                    b,
                    is_valid,
                    length[i],
                    width[i],
                    length[j],
                    width[j],
                    NEGLIGIBLE if weighing else least,
                    negligible_quantile if weighing else least_quantile,
                    not weighing and (several or first),
                    chance,
                )
                matters = matters or reached
                for t in range(steps):
                    if weighing:
                        found[k, t] += share * chance[t]
                    elif not several:
                        found[k, t] = chance[t]
        for t in range(steps):
            if found[k, t] < least:
                found[k, t] = 0.0
    return found
