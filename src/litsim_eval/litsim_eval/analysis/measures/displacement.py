"""Displacement of the agents from their recorded positions.

Every agent counts at every step of its log, on the road or not: an agent that is held back at its entry counts at the
first pose of its log, and one that has left the net early at its last pose. The displacements of two runs of one case
are thus over the same agents and steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import Count, Listed, Measure, Row, Table, family, mean
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.record.run import Run, RunInfo

HORIZONS_S = (5, 10, 15, 20, 25)  # simulated time after the history, as in table II of the LitSim paper


@dataclass(frozen=True)
class Displacements:
    """Distances between box centres in the run and in the log, one entry per agent and step of the log.

    Attributes:
        step: (m,) steps after the history, up to the longest horizon.
        id: (m,) agents.
        distance: (m,) [m].
        controlled: (m,) whether the agent is under POLICY control at this step.
        ids: (n,) agents of the log, ascending.
        largest: (n,) their largest distances at steps at which the run has them on the road, -1 without any [m].
        off: (n,) whether they are ever under control or away from their logs.
        first_controlled: (n,) first step at which they are under control, later than `last_step` without any.
        last_step: last recorded step of the run.
        info: of the run.
    """

    step: IntArray
    id: IntArray
    distance: FloatArray
    controlled: BoolArray
    ids: IntArray
    largest: FloatArray
    off: BoolArray
    first_controlled: IntArray
    last_step: int
    info: RunInfo

    @property
    def horizons(self) -> tuple[int, ...]:
        """Horizons [s] of HORIZONS_S that the run reaches."""
        return tuple(h for h in HORIZONS_S if self._last(h) <= self.last_step)

    def ade_all(self, horizon: int) -> float | None:
        """Returns ADE [m] up to `horizon` [s] over all agents but the ego; None without agents."""
        return self._mean(horizon, lambda ids, _: ids != self.info.ego_id)

    def ade_controlled(self, horizon: int) -> float | None:
        """Returns ADE [m] up to `horizon` [s] over the agents under control until then; all their steps count."""
        return self._mean(horizon, lambda ids, controlled: np.isin(ids, ids[controlled]))

    def ade_ego(self, horizon: int) -> float | None:
        """Returns ADE [m] of the ego up to `horizon` [s]."""
        return self._mean(horizon, lambda ids, _: ids == self.info.ego_id)

    def agent_steps(self, horizon: int) -> int:
        """Returns agent-steps up to `horizon` [s] without the ego's: the denominator of :meth:`ade_all`."""
        return int(np.count_nonzero((self.step <= self._last(horizon)) & (self.id != self.info.ego_id)))

    def by_agent(self) -> list[dict[str, Any]]:
        """Returns each agent that is ever under control or displaced from its log, but the ego, ids ascending.

        `controlled_s` is the time after the history of its first step under control [s], None if there is none;
        `steps` the number of steps of its log, and `ade_m` the mean distance over them [m], both by horizon.
        """
        order = np.argsort(self.id, kind="stable")
        begin = self.id[order].searchsorted(self.ids)
        rows = np.split(order, begin[1:])
        return [self._of(n, rows[n]) for n in np.flatnonzero(self.off & (self.ids != self.info.ego_id)).tolist()]

    def _of(self, n: int, rows: IntArray) -> dict[str, Any]:
        step, distance, first = self.step[rows], self.distance[rows], int(self.first_controlled[n])
        since = (first - self.info.history_steps) * self.info.dt
        within = {str(horizon): distance[step <= self._last(horizon)] for horizon in self.horizons}
        return {
            "agent": int(self.ids[n]),
            "controlled_s": None if first > self.last_step else round(since, 6),
            "steps": {horizon: len(far) for horizon, far in within.items()},
            "ade_m": {horizon: float(far.mean()) if len(far) else None for horizon, far in within.items()},
        }

    def replay_error(self) -> dict[int, float]:
        """Returns the largest distance [m] of each agent that was never under control, the ego excluded."""
        replayed = ~(self.largest < 0.0) & (self.first_controlled > self.last_step) & (self.ids != self.info.ego_id)
        return dict(zip(self.ids[replayed].tolist(), self.largest[replayed].tolist(), strict=True))

    def _last(self, horizon: int) -> int:
        return self.info.history_steps + round(horizon / self.info.dt)

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
    if len(logged) and len(steps) != len(logged):
        raise ValueError(f"a run of {len(steps)} steps has a log of {len(logged)}")
    ids = logged.ids
    x, y = np.full((2, len(ids)), np.nan)  # latest pose in the run, before it has entered the first of its log
    last_step, largest, off = int(steps.step[-1]), np.full(len(ids), -1.0), np.zeros(len(ids), np.bool_)
    first_controlled = np.full(len(ids), last_step + 1)
    longest = info.history_steps + round(max(HORIZONS_S) / info.dt)
    near: list[tuple[Any, ...]] = [(*np.empty((2, 0), np.int64), np.empty(0), np.empty(0, np.bool_))]
    for begin, end in steps.blocks() if len(ids) else ():
        part, then = steps.part(begin, end), logged.part(begin, end)
        table, log, agent = part.stacked, then.stacked, ids.searchsorted(then.stacked.id)
        new = np.flatnonzero(np.isnan(x[agent]))[::-1]  # the first one of each agent is assigned last, so it stays
        x[agent[new]], y[agent[new]] = log.x[new], log.y[new]
        pose = part.rows_until(log.number, log.id)  # of the run's current or last pose in this block
        was = pose >= 0
        here = was & (table.number[pose] == log.number if len(table) else was)
        now_x, now_y = x[agent], y[agent]
        now_x[was], now_y[was] = table.x[pose[was]], table.y[pose[was]]
        controlled = here.copy()
        controlled[here] = table.of_policy[pose[here]]
        distance, step = np.hypot(now_x - log.x, now_y - log.y), part.step[log.number]
        counts = (here | (log.id != info.ego_id)) & (step > info.history_steps)
        np.maximum.at(largest, agent[here & counts], distance[here & counts])
        off[agent[counts & (controlled | (distance > 0.0))]] = True
        np.minimum.at(first_controlled, agent[counts & controlled], step[counts & controlled])
        counts &= step <= longest
        near.append((step[counts], log.id[counts], distance[counts], controlled[counts]))
        logs = np.isin(table.id, ids)
        agent = ids.searchsorted(table.id[logs])
        x[agent], y[agent] = table.x[logs], table.y[logs]  # the last one of each agent stays
    step, id_, distance, controlled = (np.concatenate(parts) for parts in zip(*near, strict=True))
    return Displacements(
        step=step,
        id=id_,
        distance=distance,
        controlled=controlled,
        ids=ids,
        largest=largest,
        off=off,
        first_controlled=first_controlled,
        last_step=last_step,
        info=info,
    )


def _by_horizon(measure: Callable[[Displacements, int], Any]) -> Callable[[Run], dict[str, Any]]:
    """Returns the function of a measure by the horizons [s] that a run reaches."""

    def value(run: Run) -> dict[str, Any]:
        far = run.once(displacements)
        return {str(horizon): measure(far, horizon) for horizon in far.horizons}

    return value


def _rows(name: str) -> tuple[Row, ...]:
    """Returns the rows of a displacement by horizon [s]."""
    of_control = name == "ade_controlled_m"
    return tuple(Row(f"{name}.{key}", mean, Table.DISPLACEMENT, key=key, of_control=of_control) for key in HORIZONS)


HORIZONS = tuple(map(str, HORIZONS_S))
CONTROLLED, ALL = "ADE@{} s, controlled", "ADE@{} s, all"
Ade = partial(Measure, unit="m", keys=HORIZONS)
MEASURES = family(
    "average displacement from the log, over the first 5, 10, … s: of agents ever under control by then, of all agents "
    "but the ego, of the ego. Agents that are held back at their entry, or are gone before their logs end, count where "
    "they would enter, or were last",
    Ade("ade_controlled_m", _by_horizon(Displacements.ade_controlled), CONTROLLED, rows=_rows("ade_controlled_m")),
    Ade("ade_all_m", _by_horizon(Displacements.ade_all), ALL, rows=_rows("ade_all_m")),
    Ade("ade_ego_m", _by_horizon(Displacements.ade_ego), "ADE@{} s, ego"),
    "the data for [paired](#as-in-the-papers-table) ADE: by horizon the steps of all logs but the ego's; of each agent "
    "ever under control or off its log, when it first was (`controlled_s`), and by horizon `steps` and `ade_m`",
    Count("displacement.agent_steps", _by_horizon(Displacements.agent_steps), keys=HORIZONS),
    Listed("displacement.agents", lambda run: run.once(displacements).by_agent()),
)
