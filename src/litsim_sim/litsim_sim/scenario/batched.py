"""Several scenarios as one, so that the stages process their agents together in the same array operations.

Each scenario of a batch is a scene of its tables (:class:`litsim_sim.core.scene.AgentTable`). Computations on single
agents run over all scenes at once; those on pairs are restricted to agents of the same scene. The answers for a scene
are bitwise equal to those that it would get alone.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path

import numpy as np

from litsim_sim.core.scene import ARRAY_FIELDS, AgentTable, ControlTable, IntArray
from litsim_sim.core.takeover import Takeover
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.changes import Act, Hide, Noise
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.scenario.signals import BatchedSignals


@dataclass(frozen=True)
class BatchedLog(Log):
    """The logs of several scenes, one after the other; the id of an agent is its row.

    Attributes:
        logs: log of each scene.
        scene: (n,) scene of each agent, ascending.
        recorded_ids: (n,) id of each agent in the recording of its scene.
    """

    logs: tuple[Log, ...]
    scene: IntArray
    recorded_ids: IntArray

    @classmethod
    def of(cls, logs: Sequence[Log]) -> BatchedLog:
        """Join `logs`; the result is as long as the longest, and no agent is on the road beyond the end of its log."""
        steps, agents = max(log.steps for log in logs), [len(log.ids) for log in logs]
        columns = {field.name: _stacked([getattr(log, field.name) for log in logs], steps) for field in fields(Log)}
        recorded_ids, scene = columns.pop("ids"), np.repeat(np.arange(len(logs)), agents)
        return cls(np.arange(sum(agents)), **columns, logs=tuple(logs), scene=scene, recorded_ids=recorded_ids)

    def table(self, step: int, lag: IntArray | None = None) -> AgentTable:
        """See :meth:`Log.table`."""
        table = super().table(step, lag)
        table.scene = self.scene[table.id]
        return table

    def recorded(self, agent: int) -> tuple[Log, int]:
        """See :meth:`Log.recorded`."""
        return self.logs[self.scene[agent]], int(self.recorded_ids[agent])


@dataclass(frozen=True, eq=False)
class BatchedScenario:
    """Scenarios of one :func:`kind` that are stepped together.

    Attributes:
        scenarios: the scenario of each scene.
        log: the batched log of all of them.
        total_steps: the last step of the longest.

    The other attributes are those of :class:`.scenario.Scenario`; arrays per scene have the entries of all.
    """

    scenarios: tuple[Scenario, ...]
    log: BatchedLog
    total_steps: int
    ego_ids: IntArray
    identities: IntArray
    history_steps: int
    roi_m: float
    steps_after_contact: tuple[int | None, ...]
    log_overlaps: LogOverlaps
    last_logged: IntArray
    signals: BatchedSignals | None
    net_path: Path
    lane_map: LaneMap
    vehicle: VehicleModel

    @classmethod
    def of(cls, scenarios: Sequence[Scenario]) -> BatchedScenario:
        """Join `scenarios`, one at least, of one :func:`kind`."""
        if len({kind(scenario) for scenario in scenarios}) != 1:
            raise ValueError(f"scenarios that differ cannot be batched: {[scenario.name for scenario in scenarios]}")
        first, log = scenarios[0], BatchedLog.of([scenario.log for scenario in scenarios])
        signals = [scenario.signals for scenario in scenarios if scenario.signals is not None]
        own_rows = [scenario.log.row(scenario.ego_id) for scenario in scenarios]
        return cls(
            scenarios=tuple(scenarios),
            log=log,
            total_steps=max(scenario.total_steps for scenario in scenarios),
            ego_ids=np.searchsorted(log.scene, np.arange(len(scenarios))) + own_rows,
            identities=np.concatenate([scenario.identities for scenario in scenarios]),
            history_steps=first.history_steps,
            roi_m=first.roi_m,
            steps_after_contact=tuple(steps for scenario in scenarios for steps in scenario.steps_after_contact),
            log_overlaps=LogOverlaps(log),
            last_logged=np.concatenate([scenario.last_logged for scenario in scenarios]),
            signals=BatchedSignals.of(signals) if signals else None,
            net_path=first.net_path,
            lane_map=first.lane_map,
            vehicle=first.vehicle,
        )

    @property
    def actors(self) -> tuple[tuple[int, Act], ...]:
        """See :attr:`.scenario.Scenario.actors`, with the ids of the batch."""
        numbered = enumerate(self.scenarios)
        return tuple((self.agent(scene, agent), act) for scene, scenario in numbered for agent, act in scenario.actors)

    def tables(self, table: AgentTable) -> list[AgentTable]:
        """Splits `table` by scene, with the ids of the recordings."""
        return [self._own_table(table, part) for part in self._parts(table.id)]

    def table(self, scene: int, table: AgentTable) -> AgentTable:
        """Returns the agents of one scene of `table`, with the ids of its recording."""
        begin, end = table.scene.searchsorted((scene, scene + 1)).tolist()
        return self._own_table(table, slice(begin, end))

    def controls(self, controls: ControlTable) -> list[ControlTable]:
        """Splits `controls` likewise."""
        own, names = self.log.recorded_ids[controls.id], [field.name for field in fields(ControlTable)][2:]
        return [
            ControlTable(controls.step, own[part], *(getattr(controls, name)[part] for name in names))
            for part in self._parts(controls.id)
        ]

    def takeovers(self, takeovers: Sequence[Takeover]) -> list[tuple[Takeover, ...]]:
        """Splits `takeovers`, agents ascending, likewise."""
        own = self.log.recorded_ids
        apart = [
            Takeover(**{**vars(t), "agent": int(own[t.agent]), "opponent": int(own[t.opponent])}) for t in takeovers
        ]
        return [tuple(apart[part]) for part in self._parts(np.array([t.agent for t in takeovers], np.int64))]

    def agent(self, scene: int, recorded_id: int) -> int:
        """Returns the id of the agent with `recorded_id` in the recording of `scene`."""
        return int(self.log.scene.searchsorted(scene)) + self.scenarios[scene].log.row(recorded_id)

    def recorded_id_in(self, scene: int) -> Callable[[int], int | None]:
        """Returns a function from agents' ids to those in the recording of `scene`; None for agents of other scenes."""
        return lambda agent: int(self.log.recorded_ids[agent]) if self.log.scene[agent] == scene else None

    def _own_table(self, table: AgentTable, part: slice) -> AgentTable:
        """See :meth:`table`; `part` is where its agents are."""
        columns = (getattr(table, name)[part] for name in ARRAY_FIELDS[1:])
        return AgentTable(table.step, self.log.recorded_ids[table.id[part]], *columns)

    def _parts(self, ids: IntArray) -> list[slice]:
        """Returns where the agents of each scene are among `ids`, which ascend."""
        ends = self.log.scene[ids].searchsorted(np.arange(len(self.scenarios) + 1)).tolist()
        return [slice(begin, end) for begin, end in pairwise(ends)]


def kind(scenario: Scenario) -> Hashable:
    """Returns a key of all that stages query once for a batch; scenarios with equal keys can be batched.

    One in which the ego is not told the truth cannot: batched egos share one table.
    """
    vehicle = tuple(vars(scenario.vehicle).items())
    controlled = None if scenario.signals is None else scenario.signals.link_names
    apart = id(scenario) if any(isinstance(change, Hide | Noise) for change in scenario.file.changes) else None
    return scenario.net_path, scenario.history_steps, scenario.roi_m, controlled, vehicle, apart


def _stacked(parts: Sequence[np.ndarray], steps: int) -> np.ndarray:
    """Concatenates `parts` (n,) or (n, s) along the first axis, the latter padded with zeros to (n, `steps`)."""
    if parts[0].ndim == 1:
        return np.concatenate(parts)
    return np.concatenate([np.pad(part, ((0, 0), (0, steps - part.shape[1]))) for part in parts])
