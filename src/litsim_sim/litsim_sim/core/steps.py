"""Successive steps as arrays, for computations over all steps in one call."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import cached_property
from typing import Any, TypeVar, overload

import numpy as np

from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentTable, BoolArray, IntArray

T = TypeVar("T")
BLOCK, GROWTH = 500, 1.125  # tables that are held one by one while steps are collected; of their arrays


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
    """S immutable tables of successive steps, also as arrays; once there are arrays, tables are made of their parts."""

    def __init__(self, tables: Iterable[AgentTable]) -> None:
        self._tables: tuple[AgentTable, ...] | None = tuple(tables)
        self._whole: tuple[Steps, int] | None = None  # of which these are the steps from an index on
        self._results: dict[Hashable, Any] = {}

    @classmethod
    def split(cls, step: IntArray, begin: IntArray, stacked: StackedTable) -> Steps:
        """Returns the steps `step` (S,), each the rows of `stacked` from its `begin` (S + 1,) to the next."""
        steps = cls(())
        vars(steps).update(step=step, begin=begin, stacked=stacked, _tables=None)
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
        if self._tables is not None:
            return self._tables[at]
        if isinstance(at, slice):
            return tuple(self._part(k) for k in range(*at.indices(len(self))))
        if not -len(self) <= at < len(self):
            raise IndexError(f"step {at} of {len(self)}")
        return self._part(at % len(self))

    def __len__(self) -> int:
        return len(self.step) if self._tables is None else len(self._tables)

    @cached_property
    def step(self) -> IntArray:
        """(S,) the steps."""
        return np.array([table.step for table in self._tables or ()], np.int64)

    @cached_property
    def follows(self) -> BoolArray:
        """(S,) whether a table directly follows the one before: False for the first, and after a gap in a recording."""
        return np.diff(self.step, prepend=self.step[:1]) == 1

    @cached_property
    def begin(self) -> IntArray:
        """(S + 1,) row in :attr:`stacked` at which each step begins; the last entry is the number of rows."""
        return np.cumsum([0, *(len(table) for table in self._tables or ())])

    @cached_property
    def stacked(self) -> StackedTable:
        """All agents of all steps; `number` is the index of the step."""
        number = np.repeat(np.arange(len(self)), np.diff(self.begin))
        first = int(self.step[0]) if len(self) else 0
        tables = self._tables or ()
        columns = {f: np.concatenate([np.empty(0, DTYPES[f]), *(getattr(t, f) for t in tables)]) for f in ARRAY_FIELDS}
        stacked = StackedTable(first, **columns, scene=number)
        self._tables = None  # their memory can be freed
        return stacked

    @cached_property
    def ids(self) -> IntArray:
        """(n,) ids of all agents that are ever on the road, ascending."""
        if self._whole is None:
            return np.unique(self.stacked.id)
        whole, first = self._whole
        order, keys = whole._by_agent  # noqa: SLF001 - of the same class
        last = order[keys.searchsorted((np.arange(len(whole.ids)) + 1) * len(whole)) - 1]
        return whole.ids[last >= whole.begin[first]]

    @property
    def agent(self) -> IntArray:
        """(m,) position in :attr:`ids` of the agent of each row of :attr:`stacked`."""
        return self.ids.searchsorted(self.stacked.id)

    @cached_property
    def _by_agent(self) -> tuple[IntArray, IntArray]:
        """Rows (m,) of :attr:`stacked` by agent and step, and ascending keys (m,) of both."""
        agent = self.agent
        order = np.argsort(agent, kind="stable")
        return order, agent[order] * len(self) + self.stacked.number[order]

    def rows_until(self, number: IntArray, ids: IntArray) -> IntArray:
        """Returns the rows (q,) in :attr:`stacked` of agents at their last steps up to some.

        Args:
            number: (q,) indices of steps.
            ids: (q,) agents.

        Returns:
            The rows; -1 for agents that have not been on the road by then.
        """
        if self._whole is not None:
            whole, first = self._whole
            return np.maximum(whole.rows_until(number + first, ids) - whole.begin[first], -1)
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
        if self._whole is not None:
            whole, first = self._whole
            rows = whole.track(agent) - whole.begin[first]
            return rows[rows >= 0]
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

    def _part(self, at: int) -> AgentTable:
        """Returns the table of the step of index `at`, without copies."""
        rows = slice(self.begin[at], self.begin[at + 1])
        return AgentTable(int(self.step[at]), *(getattr(self.stacked, name)[rows] for name in ARRAY_FIELDS))

    def _after(self, step: int) -> Steps:
        """See :meth:`after`."""
        first = int(np.searchsorted(self.step, step, "right"))
        if not first:
            return self
        rows = slice(self.begin[first], None)
        columns = {name: getattr(self.stacked, name)[rows] for name in ARRAY_FIELDS}
        number = self.stacked.number[rows] - first
        stacked = StackedTable(int(self.step[first]) if first < len(self) else 0, **columns, scene=number)
        later = Steps.split(self.step[first:], self.begin[first:] - self.begin[first], stacked)
        later._whole = self, first  # noqa: SLF001 - their tracks are parts of these
        return later


class StepsBuilder:
    """Collects tables in any order; they are held as arrays, as single tables take half as much memory again."""

    def __init__(self) -> None:
        self._sizes: dict[int, int] = {}  # of the tables, by step
        self._new: list[AgentTable] = []
        self._columns = {name: np.empty(0, DTYPES[name]) for name in ARRAY_FIELDS}
        self._rows = 0  # of the columns, that are in use

    def __len__(self) -> int:
        return len(self._sizes)

    def add(self, table: AgentTable) -> None:
        """Adds the table of a step; of several for one step, the first counts."""
        if table.step not in self._sizes:
            self._sizes[table.step] = len(table)
            self._new.append(table)
            if len(self._new) == BLOCK:
                self._stack()

    def steps(self) -> Steps:
        """Returns the steps, ascending; the builder is of no use then."""
        self._stack()
        columns = self._columns
        for column in columns.values():
            column.resize(self._rows, refcheck=False)
        step, size = (np.array([*values], np.int64) for values in (self._sizes, self._sizes.values()))
        if (np.diff(step) < 0).any():
            order, begin = np.argsort(step), np.cumsum([0, *size])
            rows = np.concatenate([np.arange(begin[k], begin[k + 1]) for k in order.tolist()])
            columns = {name: values[rows] for name, values in columns.items()}
            step, size = step[order], size[order]
        number = np.repeat(np.arange(len(step)), size)
        return Steps.split(step, np.cumsum([0, *size]), StackedTable(int(step[0]), **columns, scene=number))

    def _stack(self) -> None:
        """Moves the new tables into the columns, which grow in place."""
        begin, self._rows = self._rows, self._rows + sum(map(len, self._new))
        for name, column in self._columns.items():
            if self._rows > len(column):
                column.resize(int(GROWTH * self._rows), refcheck=False)
            if self._new:
                np.concatenate([getattr(t, name) for t in self._new], out=column[begin : self._rows])
        self._new = []
