"""Several scenes as one scenario, so that the stages process them together in the same array operations.

The high bits of an agent's id are the number of its scene, so that tables with agents of several scenes are ordinary
tables. Computations on single agents run over all scenes at once; those on pairs are restricted to agents of the same
scene. The answers for a scene are bitwise equal to those that it would get alone.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np

from litsim_sim.core.scene import ARRAY_FIELDS, AgentTable, ByteArray, ControlTable, IntArray
from litsim_sim.core.takeover import Takeover
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import SignalLink
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.scenario.signals import Signals

BITS = 32
"""Low bits of an id, which give the agent's row in the log of its scene; the bits above are the number of the scene."""


class BatchedTable(AgentTable):
    """A table of agents of several scenes; all are at the same step."""

    @cached_property
    def scene(self) -> IntArray:
        """(n,) number of the scene that each agent is in."""
        return self.id >> BITS


class BatchedLog(Log):
    """The logs of several scenes."""

    table_type: ClassVar[type[AgentTable]] = BatchedTable
    logs: tuple[Log, ...]

    @classmethod
    def of(cls, logs: Sequence[Log]) -> BatchedLog:
        """Join `logs`; the result is as long as the longest, and no agent is on the road beyond the end of its log."""
        steps = max(log.steps for log in logs)
        columns = {
            field.name: _stacked([getattr(log, field.name) for log in logs], steps)
            for field in fields(Log)
            if field.name != "ids"
        }
        ids = np.concatenate([(k << BITS) + np.arange(len(log.ids)) for k, log in enumerate(logs)])
        batch = cls(ids=ids, **columns)
        object.__setattr__(batch, "logs", tuple(logs))  # set beside the fields, which are the columns of its tables
        return batch

    def recorded(self, agent: int) -> tuple[Log, int]:
        """See :meth:`Log.recorded`."""
        log = self.logs[agent >> BITS]
        return log, int(log.ids[agent & ((1 << BITS) - 1)])


@dataclass(frozen=True)
class BatchedSignals:
    """The signals of several scenes on one net; see :class:`litsim_sim.scenario.signals.LinkSignals`."""

    scenes: tuple[Signals, ...]

    @property
    def links(self) -> tuple[SignalLink, ...]:
        """The signalled connections of the net, which all scenes share."""
        return self.scenes[0].links

    def of_links(self, step: int) -> ByteArray:
        """(scenes, links) :class:`litsim_sim.core.signals.SignalState`."""
        return self._states[:, :, min(step, self._states.shape[2] - 1)]

    @cached_property
    def _states(self) -> ByteArray:
        """(scenes, links, steps of the longest)."""
        steps = max(signals.states.shape[1] for signals in self.scenes)
        return np.stack(
            [
                np.pad(signals.states, ((0, 0), (0, steps - signals.states.shape[1])), "edge")[signals.link_group]
                for signals in self.scenes
            ]
        )


@dataclass(frozen=True, eq=False)
class BatchedScenario:
    """Scenes that are stepped together; see :class:`.setting.Setting`.

    Attributes:
        scenes: S scenarios of one :func:`kind`.
        log: the batched log of all of them.
        ego_ids: (S,) in it.
        total_steps: the last step of the longest.
    """

    scenes: tuple[Scenario, ...]
    log: BatchedLog
    ego_ids: IntArray
    total_steps: int

    @classmethod
    def of(cls, scenes: Sequence[Scenario]) -> BatchedScenario:
        """Join `scenes`, one at least, of one :func:`kind`."""
        if len({kind(scene) for scene in scenes}) != 1:
            raise ValueError(f"scenes that differ cannot be batched: {[scene.name for scene in scenes]}")
        egos = [(k << BITS) + scene.log.row(scene.ego_id) for k, scene in enumerate(scenes)]
        longest = max(scene.total_steps for scene in scenes)
        return cls(tuple(scenes), BatchedLog.of([scene.log for scene in scenes]), np.array(egos), longest)

    @property
    def identities(self) -> IntArray:
        """See :class:`.setting.Setting`."""
        return np.concatenate([scene.identities for scene in self.scenes])

    @property
    def history_steps(self) -> int:
        """See :class:`.setting.Setting`."""
        return self.scenes[0].history_steps

    @property
    def roi_m(self) -> float:
        """See :class:`.setting.Setting`."""
        return self.scenes[0].roi_m

    @property
    def steps_after_contact(self) -> tuple[int | None, ...]:
        """See :class:`.setting.Setting`."""
        return tuple(steps for scene in self.scenes for steps in scene.steps_after_contact)

    @cached_property
    def log_overlaps(self) -> LogOverlaps:
        """See :class:`.setting.Setting`."""
        return LogOverlaps(self.log)

    @cached_property
    def last_logged(self) -> IntArray:
        """See :class:`.setting.Setting`."""
        return np.concatenate([scene.last_logged for scene in self.scenes])

    @cached_property
    def signals(self) -> BatchedSignals | None:
        """See :class:`.setting.Setting`."""
        given = tuple(scene.signals for scene in self.scenes if scene.signals is not None)
        return BatchedSignals(given) if given else None

    @property
    def net_path(self) -> Path:
        """See :class:`.setting.Setting`."""
        return self.scenes[0].net_path

    @property
    def lane_map(self) -> LaneMap:
        """See :class:`.setting.Setting`."""
        return self.scenes[0].lane_map

    @property
    def vehicle(self) -> VehicleModel:
        """See :class:`.setting.Setting`."""
        return self.scenes[0].vehicle

    def tables(self, table: AgentTable) -> list[AgentTable]:
        """`table` split by scene, with the ids of the recordings."""
        return [self._own_table(k, table, part) for k, part in enumerate(self._parts(table.id))]

    def table(self, scene: int, table: AgentTable) -> AgentTable:
        """The agents of one scene of `table`, with the ids of its recording."""
        begin, end = np.searchsorted(table.id, np.array([scene, scene + 1]) << BITS).tolist()
        return self._own_table(scene, table, slice(begin, end))

    def controls(self, controls: ControlTable) -> list[ControlTable]:
        """`controls` split likewise."""
        names = [field.name for field in fields(ControlTable)][2:]
        return [
            ControlTable(controls.step, self.own(k, controls.id[part]), *(getattr(controls, f)[part] for f in names))
            for k, part in enumerate(self._parts(controls.id))
        ]

    def takeovers(self, takeovers: Sequence[Takeover]) -> list[tuple[Takeover, ...]]:
        """`takeovers`, agents ascending, split likewise."""
        ids = np.array([(each.agent, each.opponent) for each in takeovers], np.int64).reshape(-1, 2)
        return [
            tuple(
                Takeover(**{**vars(each), "agent": agent, "opponent": opponent})
                for each, (agent, opponent) in zip(takeovers[part], self.own(k, ids[part]).tolist(), strict=True)
            )
            for k, part in enumerate(self._parts(ids[:, 0]))
        ]

    def told(self, scene: int) -> Callable[[int], int | None]:
        """A function from an agent's id to its id in the recording of `scene`; None for agents of other scenes."""
        return lambda agent: int(self.own(scene, np.array([agent]))[0]) if agent >> BITS == scene else None

    def agent(self, scene: int, agent: int) -> int:
        """Id of the agent with id `agent` in the recording of `scene`."""
        return (scene << BITS) + self.scenes[scene].log.row(agent)

    def own(self, scene: int, ids: IntArray) -> IntArray:
        """Ids (m,) in the recording of `scene` of its agents `ids` (m,)."""
        return self.scenes[scene].log.ids[ids & ((1 << BITS) - 1)]

    def _own_table(self, scene: int, table: AgentTable, part: slice) -> AgentTable:
        """See :meth:`table`; `part` is where its agents are."""
        columns = (getattr(table, name)[part] for name in ARRAY_FIELDS[1:])
        return AgentTable(table.step, self.own(scene, table.id[part]), *columns)

    def _parts(self, ids: IntArray) -> list[slice]:
        """Where the agents of each scene are among `ids`, which ascend."""
        ends = np.searchsorted(ids, np.arange(len(self.scenes) + 1) << BITS).tolist()
        return [slice(begin, end) for begin, end in pairwise(ends)]


def kind(scenario: Scenario) -> Hashable:
    """Key of a scenario; scenarios with equal keys can be batched, as they share all that stages query once for all."""
    vehicle = tuple(vars(scenario.vehicle).items())
    controlled = None if scenario.signals is None else scenario.signals.link_names
    return scenario.net_path, scenario.history_steps, scenario.roi_m, controlled, vehicle


def _stacked(parts: Sequence[np.ndarray], steps: int) -> np.ndarray:
    """`parts` (n,) or (n, s) concatenated along the first axis, the latter padded with zeros to (n, `steps`)."""
    if parts[0].ndim == 1:
        return np.concatenate(parts)
    found, first = np.zeros((sum(map(len, parts)), steps), parts[0].dtype), 0
    for part in parts:
        found[first : first + len(part), : part.shape[1]] = part
        first += len(part)
    return found
