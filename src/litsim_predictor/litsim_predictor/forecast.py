"""What a predictor answers, and what every predictor is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray, index_of

Float32Array = npt.NDArray[np.float32]
DT_MIN_S = 1e-3
"""Least time between two steps of a forecast [s]."""


@dataclass
class Modes:
    """Less probable alternatives of agents: q further futures over T steps, frame map.

    Only the most probable of these are among them; see `litsim_predictor.models.PredictorConfig.modes`.

    Attributes:
        row: (q,) of the agent in the forecast, ascending; an agent may have several, the most probable first, or none.
        probability: (q,) of the manoeuvre.
        mean, yaw, covariance: (q, T, 2), (q, T), (q, T, 3), each as in :class:`Forecast`.
    """

    row: IntArray
    probability: Float32Array
    mean: FloatArray
    yaw: Float32Array
    covariance: Float32Array

    @classmethod
    def none(cls, steps: int = 0) -> Modes:
        """Returns no further futures, of `steps` steps."""
        return cls(
            np.empty(0, np.int64),
            np.empty(0, np.float32),
            np.empty((0, steps, 2)),
            np.empty((0, steps), np.float32),
            np.empty((0, steps, 3), np.float32),
        )

    def __len__(self) -> int:
        return len(self.row)


@dataclass
class Forecast:
    """Joint forecast of n agents over T future steps, frame map.

    Mean, heading and covariance are those of each agent's most probable manoeuvre; what else it may do is in `modes`.

    Attributes:
        step: the step it starts from.
        dt: seconds between future steps; row 0 lies `dt` after `step`.
        id: (n,) agents, ascending; only those whose forecast is wanted.
        mean: (n, T, 2) box centres [m].
        yaw: (n, T) headings [rad].
        covariance: (n, T, 3) sigma_x [m], sigma_y [m], correlation of the Gaussian around `mean`.
        maneuver_probability: (n, K) of the latent manoeuvres; K = 0 where the predictor knows none.
        valid: (n,) whether the forecast may be used.
        modes: what agents may do instead.
    """

    step: int
    dt: float
    id: IntArray
    mean: FloatArray
    yaw: Float32Array
    covariance: Float32Array
    maneuver_probability: Float32Array
    valid: BoolArray
    modes: Modes = field(default_factory=Modes.none)

    @property
    def share(self) -> FloatArray:
        """(n,) probability of the most probable manoeuvre; 1 where the predictor knows none."""
        if not self.maneuver_probability.shape[1]:
            return np.ones(len(self.id))
        return self.maneuver_probability.max(axis=1).astype(np.float64)

    @classmethod
    def empty(cls, step: int, dt: float = STEP_S, maneuvers: int = 0) -> Forecast:
        """Returns the forecast of no agents, by a predictor that knows `maneuvers`."""
        narrow = np.empty((0, 0), np.float32)
        return cls(
            step=step,
            dt=dt,
            id=np.empty(0, np.int64),
            mean=np.empty((0, 0, 2)),
            yaw=narrow,
            covariance=np.empty((0, 0, 3), np.float32),
            maneuver_probability=np.empty((0, maneuvers), np.float32),
            valid=np.empty(0, np.bool_),
        )

    def rows(self, agents: IntArray) -> IntArray:
        """Returns the row of each of `agents` (m,), -1 where there is no valid forecast."""
        rows = index_of(self.id, agents)
        if not self.valid.all():
            rows[~self.valid[rows]] = -1
        return rows


class NoPredictor:
    """Forecasts no agent, for policies that need no forecasts."""

    def observe(self, table: AgentTable) -> None:
        """Nothing is remembered."""

    def forecast(self, table: AgentTable) -> Forecast:
        """Returns an empty forecast."""
        return Forecast.empty(table.step)


class Predictor(Protocol):
    """Forecasts traffic: one of both is called once a step, in order, and it keeps what history it needs."""

    def observe(self, table: AgentTable) -> None:
        """Take note of a step for which no forecast is needed."""

    def forecast(self, table: AgentTable) -> Forecast:
        """Forecast agents of `table` that matter to the ego and to those off their log; see :mod:`.selection`."""
