"""Successive steps as arrays, for computations over all steps in one call."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import cached_property
from typing import Any, TypeVar, overload

import numpy as np

from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentTable, BoolArray, IntArray

T = TypeVar("T")


class StackedTable(AgentTable):
    """The agents of several steps as one table of (m,) rows, those of the first step first; ids ascend in each step."""

    @property
    def number(self) -> IntArray:
        """(m,) index of the step of each row; each step is a scene."""
        return self.scene

    def row(self, agent: int) -> int:
        """Not defined: an agent has a row in every step."""
        raise NotImplementedError

    def rows(self, agents: IntArray) -> IntArray:
        """Not defined, for the same reason."""
        raise NotImplementedError


class Steps(Sequence[AgentTable]):
    """S immutable tables of successive steps, also as arrays, of which the tables are then parts."""

    def __init__(self, tables: Iterable[AgentTable]) -> None:
        self._tables = tuple(tables)
        self._results: dict[Hashable, Any] = {}

    @classmethod
    def split(cls, step: IntArray, begin: IntArray, stacked: StackedTable) -> Steps:
        """Returns the steps `step` (S,), each the rows of `stacked` from its `begin` (S + 1,) to the next."""
        steps = cls(_parts(step, begin, stacked))
        vars(steps).update(step=step, begin=begin, stacked=stacked)
        return steps

    @classmethod
    def of(cls, tables: Iterable[AgentTable]) -> Steps:
        """Returns `tables` as steps, unchanged if they are a :class:`Steps`."""
        return tables if isinstance(tables, Steps) else cls(tables)

    @overload
    def __getitem__(self, at: int) -> AgentTable: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[AgentTable, ...]: ...
    def __getitem__(self, at: int | slice) -> AgentTable | tuple[AgentTable, ...]:
        return self._tables[at]

    def __len__(self) -> int:
        return len(self._tables)

    @cached_property
    def step(self) -> IntArray:
        """(S,) the steps."""
        return np.array([table.step for table in self._tables], np.int64)

    @cached_property
    def follows(self) -> BoolArray:
        """(S,) whether a table directly follows the one before: False for the first, and after a gap in a recording."""
        return np.diff(self.step, prepend=self.step[:1]) == 1

    @cached_property
    def begin(self) -> IntArray:
        """(S + 1,) row in :attr:`stacked` at which each step begins; the last entry is the number of rows."""
        return np.cumsum([0, *(len(table) for table in self._tables)])

    @cached_property
    def stacked(self) -> StackedTable:
        """All agents of all steps; `number` is the index of the step."""
        columns = {
            f: np.concatenate([np.empty(0, DTYPES[f]), *(getattr(table, f) for table in self._tables)])
            for f in ARRAY_FIELDS
        }
        number = np.repeat(np.arange(len(self)), np.diff(self.begin))
        stacked = StackedTable(int(self.step[0]) if len(self) else 0, **columns, scene=number)
        self._tables = _parts(self.step, self.begin, stacked)  # the memory of the others can be freed
        return stacked

    @cached_property
    def _agents(self) -> tuple[IntArray, IntArray]:
        """Ids (n,) of all agents, and the index among them of the agent of each row (m,)."""
        ids, agent = np.unique(self.stacked.id, return_inverse=True)
        return ids, agent

    @property
    def ids(self) -> IntArray:
        """(n,) ids of all agents that are ever on the road, ascending."""
        return self._agents[0]

    @property
    def agent(self) -> IntArray:
        """(m,) position in :attr:`ids` of the agent of each row of :attr:`stacked`."""
        return self._agents[1]

    @cached_property
    def _by_agent(self) -> tuple[IntArray, IntArray]:
        """Rows (m,) of :attr:`stacked` by agent and step, and ascending keys (m,) of both."""
        order = np.argsort(self.agent, kind="stable")
        return order, self.agent[order] * len(self) + self.stacked.number[order]

    def rows_until(self, number: IntArray, ids: IntArray) -> IntArray:
        """Returns the rows (q,) in :attr:`stacked` of agents at their last steps up to some.

        Args:
            number: (q,) indices of steps.
            ids: (q,) agents.

        Returns:
            The rows; -1 for agents that have not been on the road by then.
        """
        if not len(self.ids):
            return np.full(len(ids), -1, np.int64)
        order, keys = self._by_agent
        at = np.minimum(self.ids.searchsorted(ids), len(self.ids) - 1)
        last = keys.searchsorted(at * len(self) + np.minimum(number, len(self) - 1), "right") - 1
        there = (number >= 0) & (self.ids[at] == ids) & (keys[last] >= at * len(self)) & (last >= 0)
        return np.where(there, order[last], -1)

    def rows_at(self, number: IntArray, ids: IntArray) -> IntArray:
        """Returns the rows (q,) in :attr:`stacked` of `ids` (q,) at the steps of indices `number` (q,); -1 for none."""
        rows = self.rows_until(number, ids)
        return np.where((rows >= 0) & (self.stacked.number[rows] == number), rows, -1) if len(self.ids) else rows

    def rows_of(self, ids: IntArray) -> IntArray:
        """Returns the rows (S, k) in :attr:`stacked` of a few `ids` (k,) at each step; -1 where one is not there."""
        rows = np.full((len(self), len(ids)), -1, np.int64)
        for k, agent in enumerate(ids.tolist()):
            track = self.track(agent)
            rows[self.stacked.number[track], k] = track
        return rows

    def track(self, agent: int) -> IntArray:
        """Returns the rows (k,) in :attr:`stacked` of `agent`, of the steps at which it is on the road."""
        order, keys = self._by_agent
        at = int(self.ids.searchsorted(agent))
        if at == len(self.ids) or self.ids[at] != agent:
            return np.empty(0, np.int64)
        begin, end = keys.searchsorted([at * len(self), (at + 1) * len(self)]).tolist()
        return order[begin:end]

    @cached_property
    def overlaps(self) -> IntArray:
        """(p, 2) pairs of rows in :attr:`stacked` whose boxes overlap at one step, ascending."""
        table = self.stacked
        return overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width, table.scene)

    def after(self, step: int) -> Steps:
        """Returns the steps after `step`; the same object for every call."""
        return self.once(Steps._after, step)

    def once(self, function: Callable[..., T], *arguments: Hashable) -> T:
        """Returns the result of `function` for these steps and `arguments`, computed once and kept with the steps.

        For intermediate results of several measures, and for those of the log, whose steps are shared by all runs of a
        scenario; see :meth:`litsim_sim.scenario.log.Log.replay`.
        """
        key = function, arguments
        if key not in self._results:
            self._results[key] = function(self, *arguments)
        result: T = self._results[key]
        return result

    def _after(self, step: int) -> Steps:
        """See :meth:`after`."""
        first = int(np.searchsorted(self.step, step, "right"))
        if not first:
            return self
        rows = slice(self.begin[first], None)
        columns = {name: getattr(self.stacked, name)[rows] for name in ARRAY_FIELDS}
        number = self.stacked.number[rows] - first
        stacked = StackedTable(int(self.step[first]) if first < len(self) else 0, **columns, scene=number)
        return Steps.split(self.step[first:], self.begin[first:] - self.begin[first], stacked)


def _parts(step: IntArray, begin: IntArray, stacked: StackedTable) -> tuple[AgentTable, ...]:
    """Returns the tables of the steps `step` (S,) whose rows of `stacked` begin at `begin` (S + 1,), without copies."""
    columns = [*(getattr(stacked, name) for name in ARRAY_FIELDS), np.zeros(len(stacked), np.int64)]  # one scene
    return tuple(
        AgentTable(at, *(column[low:high] for column in columns))
        for at, low, high in zip(step.tolist(), begin[:-1].tolist(), begin[1:].tolist(), strict=True)
    )
