"""Displacement of the agents from their recorded positions.

Every agent counts at every step of its log, on the road or not: an agent that is held back at its entry counts at the
first pose of its log, and one that has left the net early at its last pose. The displacements of two runs of one case
are thus over the same agents and steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.record.run import Run

HORIZONS_S = (5, 10, 15, 20, 25)  # simulated time after the history, as in table II of the LitSim paper


@dataclass(frozen=True)
class AgentDisplacement:
    """Displacement of one agent from its log.

    Attributes:
        agent: its id.
        controlled_s: time after the history of the first step under control [s]; None if never under control.
        steps: number of steps of its log, by horizon [s].
        ade: mean distance over these steps [m], by horizon [s]; None without steps.
    """

    agent: int
    controlled_s: float | None
    steps: dict[int, int]
    ade: dict[int, float | None]


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
        """ADE [m] up to `horizon` [s] over all agents but the ego; None without agents."""
        return self._mean(horizon, lambda ids, _: ids != self.ego_id)

    def ade_controlled(self, horizon: int) -> float | None:
        """ADE [m] up to `horizon` [s] over the agents under control at any step until then; all their steps count."""
        return self._mean(horizon, lambda ids, controlled: np.isin(ids, ids[controlled]))

    def ade_ego(self, horizon: int) -> float | None:
        """ADE [m] of the ego up to `horizon` [s]."""
        return self._mean(horizon, lambda ids, _: ids == self.ego_id)

    def agent_steps(self, horizon: int) -> int:
        """Agent-steps up to `horizon` [s] without the ego's: the denominator of :meth:`ade_all`."""
        return int(np.count_nonzero((self.step <= self._last(horizon)) & (self.id != self.ego_id)))

    def apart(self) -> list[AgentDisplacement]:
        """The agents ever under control or displaced from their logs, the ego excluded, ids ascending."""
        off = (self.controlled | (self.distance > 0.0)) & (self.id != self.ego_id)
        return [self._of(agent) for agent in np.unique(self.id[off]).tolist()]

    def _of(self, agent: int) -> AgentDisplacement:
        mine = self.id == agent
        step, distance, controlled = self.step[mine], self.distance[mine], self.controlled[mine]
        ends = {horizon: step <= self._last(horizon) for horizon in self.horizons}
        return AgentDisplacement(
            agent,
            round(int(step[controlled][0] - self.history_steps) * self.dt, 6) if controlled.any() else None,
            {horizon: int(np.count_nonzero(within)) for horizon, within in ends.items()},
            {horizon: float(distance[within].mean()) if within.any() else None for horizon, within in ends.items()},
        )

    def replay_error(self) -> dict[int, float]:
        """Largest distance [m] of each agent that was never under control, the ego excluded."""
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
    """Distances of all agents to their logs over the steps after the history; empty if the bag holds no log."""
    info, steps, logged = run.info, run.steps, run.logged
    history_steps, last = info.history_steps, run.tables[-1].step
    found = _columns(steps, logged, history_steps, info.ego_id) if len(logged) else _NOTHING
    step, ids, distance, controlled, present = found
    return Displacements(step, ids, distance, controlled, present, history_steps, last, info.dt, info.ego_id)


Columns = tuple[IntArray, IntArray, FloatArray, BoolArray, BoolArray]
_NOTHING: Columns = (
    np.empty(0, np.int64),
    np.empty(0, np.int64),
    np.empty(0),
    np.empty(0, np.bool_),
    np.empty(0, np.bool_),
)


def _columns(steps: Steps, logged: Steps, history_steps: int, ego_id: int) -> Columns:
    """The first five attributes of :class:`Displacements`; the ego counts only while it is on the road.

    Raises:
        ValueError: the run and its log differ in length.
    """
    if len(steps) != len(logged):
        raise ValueError(f"a run of {len(steps)} steps has a log of {len(logged)}")
    table, log = steps.stacked, logged.stacked
    rows, then = steps.rows_of(logged.ids), logged.rows
    present = rows >= 0
    counts = (then >= 0) & (present | (logged.ids != ego_id)) & (steps.step > history_steps)[:, None]
    number, agent = np.nonzero(counts)
    # current or last pose of each agent in the run; the first pose of its log before it has entered
    last = np.maximum.accumulate(np.where(present, np.arange(len(steps))[:, None], -1), axis=0)[number, agent]
    at, start = rows[last, agent], then[np.argmax(then >= 0, axis=0), np.arange(len(logged.ids))][agent]
    was, now = last >= 0, then[number, agent]
    x, y = log.x[start], log.y[start]
    x[was], y[was] = table.x[at[was]], table.y[at[was]]
    here = present[number, agent]
    controlled = here.copy()
    controlled[here] = table.of_policy[at[here]]
    distance = np.hypot(x - log.x[now], y - log.y[now])
    return steps.step[number], logged.ids[agent], distance, controlled, here
