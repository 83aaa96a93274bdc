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
    """S immutable tables of successive steps, also as arrays."""

    def __init__(self, tables: Iterable[AgentTable]) -> None:
        self._tables = tuple(tables)
        self._results: dict[Hashable, Any] = {}

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
        return StackedTable(int(self.step[0]) if len(self) else 0, **columns, scene=number)

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
    def rows(self) -> IntArray:
        """(S, n) row in :attr:`stacked` of each of :attr:`ids` at each step; -1 where it is not on the road."""
        rows = np.full((len(self), len(self.ids)), -1, np.int64)
        rows[self.stacked.number, self.agent] = np.arange(len(self.stacked))
        return rows

    def rows_of(self, ids: IntArray) -> IntArray:
        """Returns the rows (S, k) in :attr:`stacked` of `ids` (k,) at each step; -1 where one is not on the road."""
        if not len(self.ids):
            return np.full((len(self), len(ids)), -1, np.int64)
        at = np.minimum(self.ids.searchsorted(ids), len(self.ids) - 1)
        return np.where(self.ids[at] == ids, self.rows[:, at], -1)

    def track(self, agent: int) -> IntArray:
        """Returns the rows (k,) in :attr:`stacked` of `agent`, of the steps at which it is on the road."""
        rows = self.rows_of(np.array([agent]))[:, 0]
        return rows[rows >= 0]

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
        return Steps(table for table in self if table.step > step)
