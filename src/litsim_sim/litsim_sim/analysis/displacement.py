"""How far the agents are from where the recording had them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import AgentTable, Controller, FloatArray, IntArray
from litsim_sim.record.run import Run

HORIZONS_S = (5, 10, 15, 20, 25)  # of simulation, as in the LitSim paper's table II

_CONTROLLED = (Controller.POLICY, Controller.BASELINE)


@dataclass(frozen=True)
class Displacements:
    """Distances between box centres in the run and in the log, one entry per agent and step where both are on the road.

    Attributes:
        step: (m,) steps after the history.
        id: (m,) agents.
        distance: (m,) [m].
        controlled: (m,) whether the agent is under POLICY or BASELINE control at this step.
        history_steps: last step of the history.
        last_step: last step of the run that was recorded.
        dt: duration of a step [s].
        ego_id: the ego.
    """

    step: IntArray
    id: IntArray
    distance: FloatArray
    controlled: np.ndarray
    history_steps: int
    last_step: int
    dt: float
    ego_id: int

    @property
    def horizons(self) -> tuple[int, ...]:
        """The horizons [s] of HORIZONS_S that the run is long enough for."""
        return tuple(h for h in HORIZONS_S if self._last(h) <= self.last_step)

    def ade_all(self, horizon: int) -> float | None:
        """ADE [m] up to `horizon` [s] over all agents but the ego; None where there is none."""
        return self._mean(horizon, lambda ids, _: ids != self.ego_id)

    def ade_controlled(self, horizon: int) -> float | None:
        """ADE [m] up to `horizon` [s] over the agents that were under control at some step up to there.

        All their steps count, those on the log included.
        """
        return self._mean(horizon, lambda ids, controlled: np.isin(ids, ids[controlled]))

    def ade_ego(self, horizon: int) -> float | None:
        """ADE [m] of the ego up to `horizon` [s]."""
        return self._mean(horizon, lambda ids, _: ids == self.ego_id)

    def replay_error(self) -> dict[int, float]:
        """Largest distance [m] of each agent that was never under control, the ego excluded."""
        apart = np.isin(self.id, self.id[self.controlled]) | (self.id == self.ego_id)
        ids, inverse = np.unique(self.id[~apart], return_inverse=True)
        largest = np.zeros(len(ids))
        np.maximum.at(largest, inverse, self.distance[~apart])
        return dict(zip(ids.tolist(), largest.tolist(), strict=True))

    def _last(self, horizon: int) -> int:
        return self.history_steps + round(horizon / self.dt)

    def _mean(self, horizon: int, which: Callable[[IntArray, np.ndarray], np.ndarray]) -> float | None:
        within = self.step <= self._last(horizon)
        distance = self.distance[within][which(self.id[within], self.controlled[within])]
        return float(distance.mean()) if len(distance) else None


def displacements(run: Run) -> Displacements:
    """Distances to the log over the steps after the history, of all agents; empty where the bag holds no log."""
    pairs = zip(run.simulated, run.simulated_log, strict=True) if run.log else ()
    parts = [_distances(table, logged) for table, logged in pairs]
    step, ids, distance, controlled = (np.concatenate(c) for c in zip(*parts, strict=True)) if parts else _NOTHING
    info = run.info
    return Displacements(step, ids, distance, controlled, info.history_steps, run.tables[-1].step, info.dt, info.ego_id)


_NOTHING = (np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0, np.bool_))


def _distances(table: AgentTable, logged: AgentTable) -> tuple[IntArray, IntArray, FloatArray, np.ndarray]:
    rows = logged.rows(table.id)
    both = rows >= 0
    now, then = table.take(both), logged.take(rows[both])
    distance = np.hypot(now.x - then.x, now.y - then.y)
    return np.full(len(now), table.step), now.id, distance, np.isin(now.controller, _CONTROLLED)
