"""What a predictor answers, and what every predictor is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray

Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Forecast:
    """Joint forecast of n agents over T future steps, frame map.

    Attributes:
        step: the step it starts from.
        dt: seconds between future steps; row 0 lies `dt` after `step`.
        id: (n,) agents, ascending.
        mean: (n, T, 2) box centres [m].
        yaw: (n, T) headings [rad].
        covariance: (n, T, 3) sigma_x [m], sigma_y [m], correlation of the Gaussian around `mean`.
        maneuver_probability: (n, K) of the latent manoeuvres; K = 0 where the predictor knows none.
        valid: (n,) whether the forecast may be used.
    """

    step: int
    dt: float
    id: IntArray
    mean: FloatArray
    yaw: Float32Array
    covariance: Float32Array
    maneuver_probability: Float32Array
    valid: BoolArray

    def rows(self, agents: IntArray) -> IntArray:
        """Row of each of `agents` (m,), -1 where there is no valid forecast."""
        if not len(self.id):
            return np.full(len(agents), -1, np.int64)
        at = np.minimum(np.searchsorted(self.id, agents), len(self.id) - 1)
        return np.where((self.id[at] == agents) & self.valid[at], at, -1)


class Predictor(Protocol):
    """Forecasts traffic: it is called once a step, in order, and keeps what history it needs."""

    def forecast(self, table: AgentTable) -> Forecast:
        """Forecast the agents of `table` that matter to the ego and to those off their log."""


def agents_of_interest(table: AgentTable, ego_id: int, roi_m: float) -> BoolArray:
    """(n,) agents within `roi_m` metres of the ego or of another agent off its log, those included."""
    centre = table.off_log | (table.id == ego_id)
    dx = table.x[:, None] - table.x[centre][None, :]
    dy = table.y[:, None] - table.y[centre][None, :]
    return centre | (dx**2 + dy**2 <= roi_m**2).any(axis=1)
