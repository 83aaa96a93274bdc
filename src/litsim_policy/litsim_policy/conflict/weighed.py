"""Overlap of agents that may do several things: the probabilities of all their motions, weighed."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from litsim_policy.conflict.futures import PredictedMotion
from litsim_policy.conflict.pairs import overlap_chances
from litsim_sim.core.scene import FloatArray, IntArray

NEGLIGIBLE = 1e-3
"""Probability that is taken as 0 in a weighed sum."""


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

    A weighed mean reaches `least` only where one of its terms does. So every motion is looked at by that bound, which
    is cheap; and only of pairs that one of them brings to it, all are integrated.

    Args:
        pairs: (m, 2) of rows: an agent in `a`, of which one motion is known, and one in `b`.
        a, b: motions of the same n agents.
        length, width: (n,) of their boxes [m].
        least: probability that matters.
        first: whether of each pair only what comes up to the first step at which it matters is asked for.
    """
    others = b.others
    several = np.isin(pairs[:, 1], others.row) if len(others) else np.zeros(len(pairs), np.bool_)
    if not several.any():
        return _chances(pairs, a, b, length, width, least, first=first)
    found = np.zeros((len(pairs), a.valid.shape[1]))
    found[~several] = _chances(pairs[~several], a, b, length, width, least, first=first)
    rows, every = np.flatnonzero(several), b.every
    pair, motion = _motions_of(pairs[rows, 1], b)
    agents = np.concatenate([np.arange(len(length)), others.row])
    asked = np.stack([pairs[rows[pair], 0], motion], axis=1)
    extents = length[agents], width[agents]
    alone = _chances(asked, a, every, *extents, least, first=True).any(axis=1)
    matters = np.zeros(len(rows), np.bool_)
    matters[pair[alone]] = True
    kept = matters[pair]
    if kept.any():
        weight = np.concatenate([_first_weights(b), others.weight])[motion[kept]]
        chance = _chances(asked[kept], a, every, *extents, NEGLIGIBLE, first=False) * weight[:, None]
        total = np.zeros((len(rows), found.shape[1]))
        np.add.at(total, pair[kept], chance)
        found[rows] = np.where(total >= least, total, 0.0)
    return found


def _chances(
    pairs: IntArray,
    a: PredictedMotion,
    b: PredictedMotion,
    length: FloatArray,
    width: FloatArray,
    least: float,
    *,
    first: bool,
) -> FloatArray:
    quantile = float(ndtri(least))
    return overlap_chances(
        pairs, a.states, a.valid, a.bounds, b.states, b.valid, b.bounds, length, width, least, quantile, first
    )


def _motions_of(agents: IntArray, b: PredictedMotion) -> tuple[IntArray, IntArray]:
    """Positions in `agents` (k,), and motions of `b.every` that the agent there has, its first one included."""
    order = np.argsort(b.others.row, kind="stable")
    rows = b.others.row[order]
    begin, end = np.searchsorted(rows, agents), np.searchsorted(rows, agents, "right")
    count = end - begin
    pair = np.repeat(np.arange(len(agents)), count)
    at = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
    return np.concatenate([np.arange(len(agents)), pair]), np.concatenate([agents, len(b.states) + order[at]])


def _first_weights(b: PredictedMotion) -> FloatArray:
    """(n,) weights of the first motions."""
    return np.asarray(1.0 - np.bincount(b.others.row, b.others.weight, len(b.states)), np.float64)
