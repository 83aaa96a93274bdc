"""Cubic smoothing splines on uniform knots, fitted by robust penalised least squares.

These are the P-splines of Eilers and Marx ("Flexible smoothing with B-splines and penalties", Statistical Science 11,
1996): cubic B-splines with penalties on differences of their coefficients. The third difference is, exactly, the third
derivative of the curve, which is constant between knots. Every matrix here is symmetric with three diagonals below the
main one, so a fit takes time and memory in proportion to the number of knots.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import cast

import numpy as np
from scipy.linalg import solveh_banded

from litsim_sim.core.scene import FloatArray, IntArray

BAND = 4  # stored diagonals: the main one and three below
HUBER_ROUNDS = 8  # rounds of reweighting; weights have settled to about a percent by then


@dataclass(frozen=True)
class Knots:
    """Uniform knots at `origin` + `step` * (0, 1, ..., `pieces`), `pieces` at least 1."""

    origin: float
    step: float
    pieces: int

    @property
    def size(self) -> int:
        """Number of coefficients of a spline on these knots."""
        return self.pieces + 3

    def places(self) -> FloatArray:
        """Returns the positions (pieces + 1,) of the knots, in the unit of the parameter."""
        return self.origin + self.step * np.arange(self.pieces + 1, dtype=np.float64)

    def basis(self, places: FloatArray, derivative: int = 0) -> tuple[IntArray, FloatArray]:
        """Returns the four B-splines that are not zero at `at` (n,), clipped to the range of the knots.

        Returns:
            Index (n,) of the first of them, and values (n, 4) of their `derivative`-th derivative (0 to 2).
        """
        scaled = np.clip((places - self.origin) / self.step, 0.0, self.pieces)
        first = np.minimum(scaled.astype(np.int64), self.pieces - 1)
        u = scaled - first
        v = 1.0 - u
        if derivative == 0:
            values = [v**3, 3 * u**3 - 6 * u**2 + 4, 3 * v**3 - 6 * v**2 + 4, u**3]
        elif derivative == 1:
            values = [-3 * v**2, 9 * u**2 - 12 * u, 12 * v - 9 * v**2, 3 * u**2]
        else:
            values = [6 * v, 18 * u - 12, 18 * v - 12, 6 * u]
        return first, np.stack(values, axis=1) / (6.0 * self.step**derivative)

    def evaluate(self, coefficients: FloatArray, places: FloatArray, derivative: int = 0) -> FloatArray:
        """Returns the value or derivative (n, ...) at `at` (n,) of the spline with `coefficients` (size, ...)."""
        first, values = self.basis(places, derivative)
        near = coefficients[first[:, None] + np.arange(4)]
        if derivative:  # equal in theory, and exactly zero where the spline is constant
            near = near - near[:, :1]
        return cast(FloatArray, np.einsum("nk,nk...->n...", values, near))

    def gram(self, first: IntArray, rows: FloatArray, weight: FloatArray) -> FloatArray:
        """Returns lower diagonals (4, size) of ``R' diag(weight) R``, row i of R holding `rows[i]` from `first[i]`
        on.
        """
        bands = np.zeros((BAND, self.size))
        width = rows.shape[1]
        for below in range(width):
            for left in range(width - below):
                product = weight * rows[:, left] * rows[:, left + below]
                bands[below] += np.bincount(first + left, product, self.size)
        return bands

    def project(self, first: IntArray, rows: FloatArray, values: FloatArray) -> FloatArray:
        """Returns ``R' values`` (size, m) for `values` (n, m), R as in :meth:`gram`."""
        total = np.zeros((self.size, values.shape[1]))
        for column in range(values.shape[1]):
            for left in range(rows.shape[1]):
                total[:, column] += np.bincount(first + left, rows[:, left] * values[:, column], self.size)
        return total

    def penalty(self, order: int, weight: FloatArray | float) -> FloatArray:
        """Returns lower diagonals (4, size) of the integral of `weight` times the squared derivative of `order` (1
        to 3).

        Args:
            order: order of the derivative; exact for 3, by differences of coefficients for 1 and 2.
            weight: a number, or one per difference (size - order,).
        """
        first, rows = self.differences(order)
        return self.gram(first, rows, np.broadcast_to(weight, len(first)) * self.step)

    def pull(self, order: int, weight: FloatArray, target: FloatArray) -> FloatArray:
        """Returns the right-hand side (size, m) for a :meth:`penalty` on the difference from `target` (n, m)."""
        first, rows = self.differences(order)
        return self.project(first, rows, (weight * self.step)[:, None] * target)

    def differences(self, order: int) -> tuple[IntArray, FloatArray]:
        """Returns differences of coefficients that approximate a derivative: first index (n,), rows (n, order + 1)."""
        signs = np.array([(-1.0) ** (order - k) * comb(order, k) for k in range(order + 1)])
        count = self.size - order
        return np.arange(count), np.broadcast_to(signs / self.step**order, (count, order + 1))


def solve(bands: FloatArray, right: FloatArray) -> FloatArray:
    """Returns the solution (size, m) of the positive definite system with lower diagonals `bands` (4, size)."""
    return cast(FloatArray, solveh_banded(bands, right, lower=True, check_finite=False))


def huber_weight(residual: FloatArray, limit: float) -> FloatArray:
    """Returns weights (n,) of residuals (n, m) by their length: 1 up to `limit`, then falling as its inverse.

    Huber, "Robust estimation of a location parameter", Annals of Mathematical Statistics 35, 1964.
    """
    return cast(FloatArray, limit / np.maximum(np.linalg.norm(residual, axis=1), limit))


def fit(
    knots: Knots,
    basis: tuple[IntArray, FloatArray],
    values: FloatArray,
    weight: FloatArray,
    penalty: FloatArray,
    limit: float,
    pull: FloatArray | float = 0.0,
) -> FloatArray:
    """Returns the spline (size, m) that minimises squared residuals, Huber beyond `limit`, plus `penalty`.

    Args:
        basis: (n,), (n, 4) linear map from coefficients to measurements, in the form of :meth:`Knots.basis`.
        values: (n, m) measurements.
        weight: (n,) weights of the measurements.
        penalty: (4, size) lower diagonals; must make the system positive definite.
        limit: length of a residual beyond which it counts linearly.
        pull: (size, m) added to the right-hand side, see :meth:`Knots.pull`.
    """
    first, rows = basis
    robust = np.ones(len(values))
    for _ in range(HUBER_ROUNDS):
        total = weight * robust
        bands = knots.gram(first, rows, total) + penalty
        coefficients = solve(bands, knots.project(first, rows, total[:, None] * values) + pull)
        fitted = np.einsum("nk,nkm->nm", rows, coefficients[first[:, None] + np.arange(4)])
        renewed = huber_weight(values - fitted, limit)
        settled = np.abs(renewed - robust).max() < 0.01
        robust = renewed
        if settled:
            break
    return coefficients
