"""Statistics of encounters drawn with repetition: each is computed for many draws at once, for bootstrap intervals.

`times` (d, n) is how often each of n encounters is in each of d draws; :func:`once` is the sample itself. Values are
(n,), or (n, k) where an encounter was driven k times; NaN stands for an absent one.
"""

from __future__ import annotations

import numpy as np

from litsim_sim.core.scene import BoolArray, FloatArray


def once(count: int) -> FloatArray:
    """Returns `times` (1, n) of the sample itself: each of `count` encounters once."""
    return np.ones((1, count))


def means(values: FloatArray | BoolArray, times: FloatArray) -> FloatArray:
    """Returns the mean of the present `values` in each draw (d,); nan where a draw has none."""
    values, weights = _present(values, times)
    total, count = weights @ values, weights.sum(axis=1)
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)


def medians(values: FloatArray, times: FloatArray) -> FloatArray:
    """Returns the median of the present `values` in each draw (d,); nan where a draw has none."""
    values, weights = _present(values, times)
    if not len(values):
        return np.full(len(times), np.nan)
    order = values.argsort(kind="stable")
    ranked, upto = values[order], weights[:, order].cumsum(axis=1)
    count = upto[:, -1]
    low, high = (ranked[(upto > rank[:, None]).argmax(axis=1)] for rank in ((count - 1) // 2, count // 2))
    return np.where(count > 0, (low + high) / 2, np.nan)


def ks_distances(simulated: FloatArray, people: FloatArray, times: FloatArray) -> FloatArray:
    """Returns the Kolmogorov-Smirnov distance of two distributions in each draw (d,).

    It is the largest difference of their cumulative shares; an absent value counts as greater than all others, so that
    those who never react count. `simulated` is (n,) or (n, k), `people` (n,).
    """
    (own, own_times), (other, other_times) = _flat(simulated, times), _flat(people, times)
    both = np.concatenate([own, other])
    both = np.where(np.isnan(both), np.inf, both)
    order = both.argsort(kind="stable")
    ranked = both[order]
    last = np.append(ranked[1:] != ranked[:-1], True)  # of equal values
    totals = own_times.sum(axis=1, keepdims=True), other_times.sum(axis=1, keepdims=True)
    signed = np.concatenate([own_times * totals[1], -other_times * totals[0]], axis=1)  # whole numbers: exact sums
    apart = np.abs(signed[:, order].cumsum(axis=1)[:, last]).max(axis=1)
    return np.asarray(apart / (totals[0] * totals[1])[:, 0])


def areas_under_curve(scores: FloatArray, positive: BoolArray, times: FloatArray) -> FloatArray:
    """Returns the area under the ROC curve in each draw (d,); nan where a draw lacks either kind.

    It is the probability that `scores` (n,) rank a random encounter that is `positive` (n,) above a random one that is
    not; equal scores count half.
    """
    above, below = scores[positive][:, None], scores[~positive]
    wins = (above > below) + 0.5 * (above == below)
    of_positive, of_rest = times[:, positive], times[:, ~positive]
    total = of_positive.sum(axis=1) * of_rest.sum(axis=1)
    won = ((of_positive @ wins) * of_rest).sum(axis=1)
    return np.divide(won, total, out=np.full(len(total), np.nan), where=total > 0)


def kappas(simulated: BoolArray, people: BoolArray, times: FloatArray) -> FloatArray:
    """Returns Cohen's kappa of two verdicts (n,) in each draw (d,): agreement beyond chance; nan where chance is 1."""
    agreed, own, other = means(simulated == people, times), means(simulated, times), means(people, times)
    chance = own * other + (1 - own) * (1 - other)
    return np.divide(agreed - chance, 1 - chance, out=np.full(len(chance), np.nan), where=chance < 1)


def crps(drawn: FloatArray, truth: FloatArray) -> FloatArray:
    """Returns the continuous ranked probability score (n,) of `drawn` (n, k) values for the `truth` (n,), k > 1.

    It is in the unit of the values, and the absolute error if all draws are equal (Gneiting and Raftery 2007); the
    spread is that of pairs of different draws, so that the number of draws does not matter on average.
    """
    k = drawn.shape[1]
    error = np.abs(drawn - truth[:, None]).mean(axis=1)
    spread = np.abs(drawn[:, :, None] - drawn[:, None, :]).sum(axis=(1, 2)) / (k * (k - 1))
    return np.asarray(error - spread / 2)


def covered(drawn: FloatArray, truth: FloatArray, level: float) -> FloatArray:
    """Returns whether the central interval that holds the share `level` of `drawn` (n, k) has the `truth` (n,), (n,).

    The truth is ranked among the draws, as quantiles of few draws would be too narrow: of k + 1 exchangeable values,
    all ranks are equally probable. The central ranks count, the outermost of them in part, so that the mean over
    encounters is `level` for exchangeable values, whatever k is. With fewer than 19 draws, 90 % take in a part
    of the outermost ranks, and a truth far from all draws counts as covered in that part.
    """
    k = drawn.shape[1]
    rank = (drawn < truth[:, None]).sum(axis=1) + 0.5 * (drawn == truth[:, None]).sum(axis=1)
    inside = np.clip(level * (k + 1) / 2 + 0.5 - np.abs(rank - k / 2), 0.0, 1.0)
    return np.where(np.isnan(drawn).any(axis=1), np.nan, inside)


def _flat(values: FloatArray | BoolArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns `values` as (m,), and how often each is in each draw (d, m)."""
    repeats = 1 if values.ndim == 1 else values.shape[1]
    return values.astype(np.float64).ravel(), np.repeat(times, repeats, axis=1)


def _present(values: FloatArray | BoolArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns the present `values` (m,), and how often each is in each draw (d, m)."""
    flat, weights = _flat(values, times)
    there = ~np.isnan(flat)
    return flat[there], weights[:, there]
