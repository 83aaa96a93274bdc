"""What all bootstraps over runs have in common: number of draws, their seed, and the share within the bounds."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from litsim_sim.core.scene import FloatArray, IntArray

LEVEL, RESAMPLES, SEED = 0.95, 2000, 0
"""Bootstrap of all reported bounds: share of the draws within them, number of draws, and seed."""


def drawn_units(count: int) -> IntArray:
    """Returns (RESAMPLES, count) positions of `count` units, drawn with replacement, the same at every call."""
    return np.random.default_rng(SEED).integers(count, size=(RESAMPLES, count))


@lru_cache(maxsize=8)
def times_drawn(count: int) -> FloatArray:
    """Returns (RESAMPLES, count) how often each of `count` units is in each of the draws of :func:`drawn_units`."""
    times = np.stack([np.bincount(draw, minlength=count) for draw in drawn_units(count)]).astype(np.float64)
    times.setflags(write=False)
    return times


def percentile_bounds(figures: FloatArray) -> tuple[float, float] | None:
    """Returns bounds of a figure from its values in the draws (Efron 1979) that are not nan; None if all are."""
    finite = figures[np.isfinite(figures)]
    if not len(finite):
        return None
    low, high = np.quantile(finite, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def ratios(above: FloatArray, below: FloatArray) -> FloatArray:
    """Returns `above` over `below` by draw; nan where `below` is 0."""
    return np.divide(above, below, out=np.full(len(above), np.nan), where=below > 0)
