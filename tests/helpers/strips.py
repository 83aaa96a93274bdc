"""Probability that two oriented boxes overlap when their distance is Gaussian, in numpy: what kernels must give.

Two boxes overlap where the vector from one centre to the other lies in the Minkowski sum of both, which for rectangles
is the intersection of four strips: one for each edge direction, as in the separating-axis test. Each strip alone bounds
the probability from above, which is what makes the broad phase cheap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from litsim_policy.conflict.overlap import FLAT, NODES, REACH, SIGMA_MIN
from litsim_sim.core.scene import BoolArray, FloatArray

_NODE, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


@dataclass(frozen=True)
class Strips:
    """The region of centre distances in which two boxes overlap: |normal . distance| < half, for each of four normals.

    Attributes:
        normal_x, normal_y: (4, ...) unit normals: along a, left of a, along b, left of b.
        edge: (4, ...) half extents of the boxes: length and width of a, of b [m].
        half: (4, ...) half widths of the strips [m].
    """

    normal_x: FloatArray
    normal_y: FloatArray
    edge: FloatArray
    half: FloatArray

    @classmethod
    def of(
        cls,
        yaw_a: FloatArray,
        yaw_b: FloatArray,
        size_a: tuple[FloatArray, FloatArray],
        size_b: tuple[FloatArray, FloatArray],
    ) -> Strips:
        """Strips of boxes with headings (...) [rad] and lengths and widths (...) [m]."""
        cos_a, sin_a, cos_b, sin_b = np.cos(yaw_a), np.sin(yaw_a), np.cos(yaw_b), np.sin(yaw_b)
        cos, sin = np.abs(cos_a * cos_b + sin_a * sin_b), np.abs(sin_a * cos_b - cos_a * sin_b)
        la, wa, lb, wb = 0.5 * size_a[0], 0.5 * size_a[1], 0.5 * size_b[0], 0.5 * size_b[1]
        along_a, left_a = la + lb * cos + wb * sin, wa + lb * sin + wb * cos
        along_b, left_b = lb + la * cos + wa * sin, wb + la * sin + wa * cos
        return cls(
            np.stack([cos_a, -sin_a, cos_b, -sin_b]),
            np.stack([sin_a, cos_a, sin_b, cos_b]),
            np.stack([la, wa, lb, wb]),
            np.stack([along_a, left_a, along_b, left_b]),
        )

    def along(self, dx: FloatArray, dy: FloatArray) -> FloatArray:
        """(4, ...) distances (...) along the normals."""
        return self.normal_x * dx + self.normal_y * dy

    def variance(self, covariance: FloatArray) -> FloatArray:
        """(4, ...) variances along the normals of covariances (3, ...): xx, yy, xy [m2]."""
        xx, yy, xy = covariance
        return self.normal_x**2 * xx + self.normal_y**2 * yy + 2.0 * self.normal_x * self.normal_y * xy

    def can_reach(self, dx: FloatArray, dy: FloatArray, covariance: FloatArray, probability: float) -> BoolArray:
        """(...) False where no strip can hold as much as `probability` of the Gaussian around (dx, dy)."""
        beyond = np.abs(self.along(dx, dy)) - self.half
        slack = -float(ndtri(probability)) * np.sqrt(np.maximum(self.variance(covariance), 0.0))
        return np.asarray((beyond < slack).all(axis=0))

    def contain(self, dx: FloatArray, dy: FloatArray) -> BoolArray:
        """(...) whether the boxes overlap when their distance is exactly (dx, dy)."""
        return np.asarray((np.abs(self.along(dx, dy)) < self.half).all(axis=0))

    def probability(self, dx: FloatArray, dy: FloatArray, covariance: FloatArray) -> FloatArray:
        """Probability (m,) that the boxes overlap, for a Gaussian distance.

        Turned into the principal axes of the covariance and scaled by its standard deviations, the Gaussian is
        standard and the region is a polygon. Its probability is the integral over u of phi(u) [Phi(v2(u)) - Phi(v1(u))]
        with (v1, v2) the cut of the polygon at u: Gauss-Legendre over u, exact along v. With u along the minor axis the
        cut changes gently; where an edge is nearly across u, it changes at once, at an end of the u that are
        integrated. The error is below 0.02 (see the test against Monte Carlo), and nearly nil where the boxes lie along
        the principal axes, as they do in a lane.

        Args:
            dx, dy: (m,) mean distance, centre of b minus centre of a, frame map [m].
            covariance: (3, m) of the distance: xx, yy, xy [m2].
        """
        xx, yy, xy = covariance
        turn = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi  # of the minor axis
        cos, sin = np.cos(turn), np.sin(turn)
        sigma_u = np.sqrt(np.maximum(cos**2 * xx + sin**2 * yy + 2.0 * cos * sin * xy, SIGMA_MIN**2))
        sigma_v = np.sqrt(np.maximum(sin**2 * xx + cos**2 * yy - 2.0 * cos * sin * xy, SIGMA_MIN**2))
        middle = self.along(dx, dy)
        by_u = sigma_u * (self.normal_x * cos + self.normal_y * sin)
        by_v = sigma_v * (self.normal_y * cos - self.normal_x * sin)
        mean_u, extent = dx * cos + dy * sin, self.extent(cos, sin)
        flipped = by_v < 0.0
        steep = 1.0 / np.maximum(np.abs(by_v), FLAT)
        offset = np.where(flipped, -1.0, 1.0) * steep * middle
        slope = np.where(flipped, -1.0, 1.0) * steep * by_u
        with np.errstate(divide="ignore", invalid="ignore"):
            across = np.abs(slope) > FLAT
            nearest, reach = -offset / slope, (self.half * steep + REACH) / np.abs(slope)
            low = np.where(across, nearest - reach, -REACH).max(axis=0, initial=-REACH)
            high = np.where(across, nearest + reach, REACH).min(axis=0, initial=REACH)
        low, high = np.maximum(low, (-extent - mean_u) / sigma_u), np.minimum(high, (extent - mean_u) / sigma_u)
        high = np.maximum(low, high)
        u = 0.5 * (high + low) + 0.5 * (high - low) * _NODE[:, None]
        centre = -(offset[:, None] + slope[:, None] * u)
        width = (self.half * steep)[:, None]
        v_low, v_high = (centre - width).max(axis=0), (centre + width).min(axis=0)
        inner = np.maximum(ndtr(v_high) - ndtr(v_low), 0.0) * np.exp(-0.5 * u**2)
        total = (_WEIGHT[:, None] * inner).sum(axis=0)
        return np.asarray(0.5 * (high - low) * total / np.sqrt(2.0 * np.pi))

    def extent(self, cos: FloatArray, sin: FloatArray) -> FloatArray:
        """(...) half width [m] of the region along the direction (cos, sin)."""
        return np.asarray((self.edge * np.abs(self.normal_x * cos + self.normal_y * sin)).sum(axis=0))
