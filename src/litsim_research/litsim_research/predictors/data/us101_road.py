"""Conversion of NGSIM's road coordinates of US-101 to frame map, fitted to rows that contain both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from litsim_data.ngsim.sites import US101
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray

DEGREE = 5  # degree of the polynomials: residuals are half a millimetre, with lower degrees decimetres
MIDDLE, SPAN = 300.0, 300.0  # [m] offset and scale of local_y
TOLERANCE = 0.05  # [m] largest residual of a valid fit


@dataclass(frozen=True)
class Us101Road:
    """Polynomials from road coordinates to frame map.

    Attributes:
        coefficients: (2 * DEGREE + 1, 2) coefficients of x and y [m]: first those of the line local_x = 0, then those
            of the change per metre to the right.
        end: largest local_y [m] of the fit.
    """

    coefficients: FloatArray
    end: float

    @classmethod
    def fit(cls, table: pd.DataFrame, where: str) -> Us101Road:
        """Fit to columns local_x_m, local_y_m, global_x_m, global_y_m of `table`; `where` names it in errors.

        Raises:
            InputError: the coordinates do not agree with each other.
        """
        along, across = table["local_y_m"].to_numpy(np.float64), table["local_x_m"].to_numpy(np.float64)
        x, y = US101.map_from_global(table["global_x_m"].to_numpy(np.float64), table["global_y_m"].to_numpy(np.float64))
        terms, truth = cls._terms(along, across), np.stack([x, y], axis=-1)
        coefficients = np.asarray(np.linalg.lstsq(terms, truth, rcond=None)[0], np.float64)
        worst = float(np.abs(terms @ coefficients - truth).max())
        if worst > TOLERANCE:
            raise InputError(
                f"{where}: columns local_x_m, local_y_m and global_x_m, global_y_m disagree by {worst:.2f} m; expected "
                f"the same road, within {TOLERANCE} m"
            )
        return cls(coefficients, float(along.max()))

    def pose(self, along: FloatArray, across: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns x, y [m] and heading of the road [rad] in frame map, (n,) each, at local_y, local_x (n,) [m]."""
        x, y = (self._terms(along, across) @ self.coefficients).T
        ahead_x, ahead_y = (self._terms(along + 1.0, across) @ self.coefficients).T
        return x, y, np.arctan2(ahead_y - y, ahead_x - x)

    def scale(self, along: FloatArray) -> FloatArray:
        """Returns the length (n,) in frame map [m] of one metre of local_y at `along` (n,) [m]: about 0.99."""
        line = np.zeros_like(along)
        step = (self._terms(along + 0.5, line) - self._terms(along - 0.5, line)) @ self.coefficients
        return np.asarray(np.hypot(step[:, 0], step[:, 1]), np.float64)

    @staticmethod
    def _terms(along: FloatArray, across: FloatArray) -> FloatArray:
        u = (along - MIDDLE) / SPAN
        return np.stack([u**k for k in range(DEGREE + 1)] + [across * u**k for k in range(DEGREE)], axis=-1)
