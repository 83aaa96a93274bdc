"""Displacement of the agents from their recorded positions.

Every agent counts at every step of its log, on the road or not: an agent that is held back at its entry counts at the
first pose of its log, and one that has left the net early at its last pose. The displacements of two runs of one case
are thus over the same agents and steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.record.run import Run

HORIZONS_S = (5, 10, 15, 20, 25)  # simulated time after the history, as in table II of the LitSim paper


@dataclass(frozen=True)
class Displacements:
    """Distances between box centres in the run and in the log, one entry per agent and step of the log.

    Attributes:
        step: (m,) steps after the history.
        id: (m,) agents.
        distance: (m,) [m].
        controlled: (m,) whether the agent is under POLICY control at this step.
        present: (m,) whether the run has the agent on the road at this step.
        history_steps: last step of the history.
        last_step: last recorded step of the run.
        dt: duration of a step [s].
        ego_id: the ego.
    """

    step: IntArray
    id: IntArray
    distance: FloatArray
    controlled: BoolArray
    present: BoolArray
    history_steps: int
    last_step: int
    dt: float
    ego_id: int

    @property
    def horizons(self) -> tuple[int, ...]:
        """Those of HORIZONS_S [s] that the run reaches."""
        return tuple(h for h in HORIZONS_S if self._last(h) <= self.last_step)

    def ade_all(self, horizon: int) -> float | None:
        """Returns ADE [m] up to `horizon` [s] over all agents but the ego; None without agents."""
        return self._mean(horizon, lambda ids, _: ids != self.ego_id)

    def ade_controlled(self, horizon: int) -> float | None:
        """Returns ADE [m] up to `horizon` [s] over the agents under control until then; all their steps count."""
        return self._mean(horizon, lambda ids, controlled: np.isin(ids, ids[controlled]))

    def ade_ego(self, horizon: int) -> float | None:
        """Returns ADE [m] of the ego up to `horizon` [s]."""
        return self._mean(horizon, lambda ids, _: ids == self.ego_id)

    def agent_steps(self, horizon: int) -> int:
        """Returns agent-steps up to `horizon` [s] without the ego's: the denominator of :meth:`ade_all`."""
        return int(np.count_nonzero((self.step <= self._last(horizon)) & (self.id != self.ego_id)))

    def by_agent(self) -> list[dict[str, Any]]:
        """Returns each agent that is ever under control or displaced from its log, but the ego, ids ascending.

        `controlled_s` is the time after the history of its first step under control [s], None if there is none;
        `steps` the number of steps of its log, and `ade_m` the mean distance over them [m], both by horizon.
        """
        off = (self.controlled | (self.distance > 0.0)) & (self.id != self.ego_id)
        order = np.argsort(self.id, kind="stable")
        ids, begin = np.unique(self.id[order], return_index=True)
        rows = dict(zip(ids.tolist(), np.split(order, begin[1:]), strict=False))  # one empty part of nobody
        return [self._of(agent, rows[agent]) for agent in np.unique(self.id[off]).tolist()]

    def _of(self, agent: int, rows: IntArray) -> dict[str, Any]:
        step, distance, controlled = self.step[rows], self.distance[rows], self.controlled[rows]
        within = {str(horizon): distance[step <= self._last(horizon)] for horizon in self.horizons}
        first = int(step[controlled][0]) if controlled.any() else None
        return {
            "agent": agent,
            "controlled_s": None if first is None else round((first - self.history_steps) * self.dt, 6),
            "steps": {horizon: len(far) for horizon, far in within.items()},
            "ade_m": {horizon: float(far.mean()) if len(far) else None for horizon, far in within.items()},
        }

    def replay_error(self) -> dict[int, float]:
        """Returns the largest distance [m] of each agent that was never under control, the ego excluded."""
        apart = np.isin(self.id, self.id[self.controlled]) | (self.id == self.ego_id) | ~self.present
        ids, inverse = np.unique(self.id[~apart], return_inverse=True)
        largest = np.zeros(len(ids))
        np.maximum.at(largest, inverse, self.distance[~apart])
        return dict(zip(ids.tolist(), largest.tolist(), strict=True))

    def _last(self, horizon: int) -> int:
        return self.history_steps + round(horizon / self.dt)

    def _mean(self, horizon: int, which: Callable[[IntArray, BoolArray], BoolArray]) -> float | None:
        within = self.step <= self._last(horizon)
        distance = self.distance[within][which(self.id[within], self.controlled[within])]
        return float(distance.mean()) if len(distance) else None


def displacements(run: Run) -> Displacements:
    """Returns the distances of all agents to their logs over the steps after the history; none if the bag holds no log.

    The ego counts only while it is on the road.

    Raises:
        ValueError: the run and its log differ in length.
    """
    info, steps, logged = run.info, run.steps, run.logged
    if not len(logged):
        logged = Steps(AgentTable.empty(table.step) for table in run.tables)
    if len(steps) != len(logged):
        raise ValueError(f"a run of {len(steps)} steps has a log of {len(logged)}")
    table, log = steps.stacked, logged.stacked
    # current or last pose of each agent in the run; the first pose of its log before it has entered
    at = steps.rows_until(log.number, log.id)
    was = at >= 0
    here = was & (table.number[at] == log.number if len(table) else was)
    counts = (here | (log.id != info.ego_id)) & (steps.step > info.history_steps)[log.number]
    now = np.flatnonzero(counts)
    at, was, here = at[now], was[now], here[now]
    start = np.unique(log.id, return_index=True)[1][logged.agent[now]]
    x, y = log.x[start], log.y[start]
    x[was], y[was] = table.x[at[was]], table.y[at[was]]
    controlled = here.copy()
    controlled[here] = table.of_policy[at[here]]
    distance = np.hypot(x - log.x[now], y - log.y[now])
    return Displacements(
        step=steps.step[log.number[now]],
        id=log.id[now],
        distance=distance,
        controlled=controlled,
        present=here,
        history_steps=info.history_steps,
        last_step=run.tables[-1].step,
        dt=info.dt,
        ego_id=info.ego_id,
    )
