"""Which pairs of agents can overlap at all: a cheap test that leaves few pairs to the exact ones of :mod:`.overlap`.

It compares all steps of two futures at once, by the strips of their boxes, each widened by the spread of the motions.
Whatever the exact tests find, this finds.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from litsim_policy.conflict.futures import Boxes, gone_straight_on
from litsim_policy.conflict.overlap import by_agent, touching
from litsim_policy.conflict.predicted_motion import XX, XY, YY, AlternativeMotions, PredictedMotion, X, Y
from litsim_sim.core.scene import STEP_S, BoolArray, IntArray
from litsim_sim.kernels.compiled import (
    Bools,
    Bools2,
    Floats2,
    Floats3,
    Ints,
    Ints2,
    OutFloats2,
    Singles2,
    kernel,
)

SLACK, SLACK_SHARE = 1e-3, 1e-5  # [m] and share of the distance by which boxes are widened, for rounding
PLACE_X, PLACE_Y, COS, SIN, ALLOWED = range(5)  # rows of the steps (5, T) of a motion


class Motions(NamedTuple):
    """m motions.

    Attributes:
        states, valid: (m, T, 6), (m, T), as in :class:`PredictedMotion`.
        cos, sin: (m, T) of the headings, in single precision.
    """

    states: Floats3
    valid: Bools2
    cos: Singles2
    sin: Singles2

    @classmethod
    def of(cls, motions: PredictedMotion | AlternativeMotions) -> Self:
        """Returns `motions` as kernels take them."""
        return cls(motions.states, motions.valid, *motions.directions)


def may_overlap(pairs: IntArray, a: PredictedMotion, b: PredictedMotion, boxes: Boxes, tail: float) -> BoolArray:
    """Returns the mask (m,) of `pairs` (m, 2) that can overlap: an agent by `a`, and one by `b` or straight on.

    The motions `a` have no alternatives. Centres may deviate from their means by `tail` spreads.
    """
    further = b.alternatives
    return _may_overlap(pairs, Motions.of(a), Motions.of(b), Motions.of(further), further.row, boxes, tail)


@kernel
def _lay_out(motions: Motions, k: int, tail: float, steps: OutFloats2) -> None:
    """Write the `steps` (5, T) of motion `k`; where it is not valid, it is infinitely far away."""
    states, valid = motions.states[k], motions.valid[k]
    for t in range(len(states)):
        steps[PLACE_X, t] = states[t, X] if valid[t] else np.inf
        steps[PLACE_Y, t] = states[t, Y]
        steps[COS, t], steps[SIN, t] = motions.cos[k, t], motions.sin[k, t]
        # at least the variance in any direction, whatever the covariance
        steps[ALLOWED, t] = tail * math.sqrt(states[t, XX] + states[t, YY] + abs(states[t, XY]))


@kernel
def _lay_out_straight(boxes: Boxes, j: int, steps: OutFloats2) -> None:
    """Write the `steps` (5, T) of agent `j` straight on."""
    cos, sin, last = math.cos(boxes.yaw[j]), math.sin(boxes.yaw[j]), round(boxes.time[j] / STEP_S)
    for t in range(steps.shape[1]):
        gone = gone_straight_on(boxes.speed[j], boxes.acceleration[j], (t + 1) * STEP_S)
        steps[PLACE_X, t] = boxes.x[j] + gone * cos if t < last else np.inf
        steps[PLACE_Y, t] = boxes.y[j] + gone * sin
        steps[COS, t], steps[SIN, t], steps[ALLOWED, t] = cos, sin, 0.0


@kernel
def _come_near(a: Floats2, b: Floats2, reach: float) -> bool:
    """Whether two motions are nearer than `reach` [m] and what is allowed to both, at any of their steps (5, T)."""
    near = 0
    for t in range(a.shape[1]):
        dx, dy = b[PLACE_X, t] - a[PLACE_X, t], b[PLACE_Y, t] - a[PLACE_Y, t]
        apart = reach + a[ALLOWED, t] + b[ALLOWED, t]
        near += dx * dx + dy * dy < apart * apart
    return near > 0


@kernel
def _meet(a: Floats2, b: Floats2, la: float, wa: float, lb: float, wb: float) -> bool:
    """Whether no strip separates two boxes at any of their steps (5, T); half lengths and widths [m]."""
    meet = 0
    for t in range(a.shape[1]):
        dx, dy = b[PLACE_X, t] - a[PLACE_X, t], b[PLACE_Y, t] - a[PLACE_Y, t]
        cos_a, sin_a, cos_b, sin_b = a[COS, t], a[SIN, t], b[COS, t], b[SIN, t]
        cos, sin = abs(cos_a * cos_b + sin_a * sin_b), abs(sin_a * cos_b - cos_a * sin_b)
        allowed = a[ALLOWED, t] + b[ALLOWED, t] + SLACK + SLACK_SHARE * (abs(dx) + abs(dy))
        along_a = abs(cos_a * dx + sin_a * dy) - (la + lb * cos + wb * sin) < allowed
        left_a = abs(cos_a * dy - sin_a * dx) - (wa + lb * sin + wb * cos) < allowed
        along_b = abs(cos_b * dx + sin_b * dy) - (lb + la * cos + wa * sin) < allowed
        left_b = abs(cos_b * dy - sin_b * dx) - (wb + la * sin + wa * cos) < allowed
        meet += along_a & left_a & along_b & left_b
    return meet > 0


@kernel
def _may_overlap(
    pairs: Ints2, a: Motions, b: Motions, further: Motions, alternative: Ints, boxes: Boxes, tail: float
) -> Bools:
    """See :func:`may_overlap`; `further` are alternative motions of b, those of the agents `alternative`."""
    count, horizon = len(boxes.x), a.states.shape[1]
    order, begin = by_agent(alternative, count)
    # of a motion on its log, and of others, made where they are needed: for each agent the first, straight on, the rest
    own, motions = np.empty((5, horizon)), np.empty((2 * count + len(alternative), 5, horizon))
    laid_out, before, may = np.zeros(count, np.bool_), -1, np.zeros(len(pairs), np.bool_)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        if i != before:
            before = i
            _lay_out(a, i, tail, own)
        first, end = 2 * j + begin[j], 2 * (j + 1) + begin[j + 1]
        if not laid_out[j]:
            laid_out[j] = True
            _lay_out(b, j, tail, motions[first])
            _lay_out_straight(boxes, j, motions[first + 1])
            for m in range(first + 2, end):
                _lay_out(further, order[m - 2 * (j + 1)], tail, motions[m])
        reach = touching(boxes.length[i], boxes.width[i], boxes.length[j], boxes.width[j]) + SLACK
        la, wa, lb, wb = 0.5 * boxes.length[i], 0.5 * boxes.width[i], 0.5 * boxes.length[j], 0.5 * boxes.width[j]
        for m in range(first, end):
            if _come_near(own, motions[m], reach) and _meet(own, motions[m], la, wa, lb, wb):
                may[k] = True
                break
    return may
