"""Successive steps as arrays, for computations over all steps in one call."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from tempfile import SpooledTemporaryFile, gettempdir
from typing import IO, Any, TypeVar, overload

import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentRows, AgentTable, BoolArray, IntArray

T = TypeVar("T")
BLOCK_ROWS = 50_000  # rows that are in memory together, of steps that are in a file
ROW = np.dtype([(name, DTYPES[name]) for name in ARRAY_FIELDS])  # of such a file


def write_temporary(file: IO[bytes], data: bytes) -> None:
    """Writes `data` to a temporary file; raises InputError if it cannot be written."""
    try:
        file.write(data)
    except OSError as error:
        raise InputError(f"{gettempdir()}: cannot hold the data of a run: {error.strerror or error}") from error


class StackedTable(AgentRows):
    """The agents of several steps as one table of (m,) rows, those of the first step first; each step is a scene."""

    @property
    def number(self) -> IntArray:
        """(m,) index of the step of each row."""
        return self.scene


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
    def __getitem__(self, index: int) -> AgentTable: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[AgentTable, ...]: ...
    def __getitem__(self, index: int | slice) -> AgentTable | tuple[AgentTable, ...]:
        if self._tables is not None:
            return self._tables[index]
        if isinstance(index, slice):
            return tuple(self._part(k) for k in range(*index.indices(len(self))))
        if not -len(self) <= index < len(self):
            raise IndexError(f"step {index} of {len(self)}")
        return self._part(index % len(self))

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
        """Returns the rows (q,) in :attr:`stacked` of `ids` (q,) at their last steps up to those of indices `number`.

        -1 stands for agents that have not been on the road by then.
        """
        if self._whole is not None:
            whole, first = self._whole
            return np.maximum(whole.rows_until(number + first, ids) - whole.begin[first], -1)
        if not len(self.ids):
            return np.full(len(ids), -1, np.int64)
        order, keys = self._by_agent
        index = np.minimum(self.ids.searchsorted(ids), len(self.ids) - 1)
        last = keys.searchsorted(index * len(self) + np.minimum(number, len(self) - 1), "right") - 1
        there = (number >= 0) & (self.ids[index] == ids) & (keys[last] >= index * len(self)) & (last >= 0)
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
        index = int(self.ids.searchsorted(agent))
        if index == len(self.ids) or self.ids[index] != agent:
            return np.empty(0, np.int64)
        begin, end = keys.searchsorted([index * len(self), (index + 1) * len(self)]).tolist()
        return order[begin:end]

    @cached_property
    def overlaps(self) -> IntArray:
        """(p, 2) pairs of rows in :attr:`stacked` whose boxes overlap at one step, ascending."""
        table = self.stacked
        return overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width, table.scene)

    def after(self, step: int) -> Steps:
        """Returns the steps after `step`; the same object for every call."""
        return self.once(type(self)._after, step)  # noqa: SLF001 - of this class

    def part(self, begin: int, end: int) -> Steps:
        """Returns the steps of indices `begin` to `end`, exclusive, in memory; these steps, if they are all of them."""
        begin, end = min(begin, len(self)), min(end, len(self))
        if end - begin == len(self):
            return self
        rows = slice(self.begin[begin], self.begin[end])
        columns = {name: getattr(self.stacked, name)[rows] for name in ARRAY_FIELDS}
        return self._split(begin, end, columns)

    def blocks(self, rows_max: int | None = None) -> Iterator[tuple[int, int]]:
        """Yields begin and end (exclusive) of indices of consecutive steps, which :meth:`part` takes.

        Each block has up to `rows_max` rows (default: BLOCK_ROWS), or is one step.
        """
        begin, rows_max = 0, rows_max or BLOCK_ROWS
        while begin < len(self):
            end = int(self.begin.searchsorted(self.begin[begin] + rows_max, "right")) - 1
            end = min(max(begin + 1, end), len(self))
            yield begin, end
            begin = end

    def parts(self) -> Iterator[Steps]:
        """Yields the steps of each of :meth:`blocks`."""
        return (self.part(begin, end) for begin, end in self.blocks())

    def only(self, agents: Iterable[int]) -> Steps:
        """Returns the steps with no other agents than `agents`, in memory."""
        wanted, numbers, parts = np.array([*agents], np.int64), [np.empty(0, np.int64)], [Steps(()).stacked]
        for begin, end in self.blocks():
            table = self.part(begin, end).stacked
            parts.append(table.take(np.isin(table.id, wanted)))
            numbers.append(begin + parts[-1].number)
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAY_FIELDS}
        number = np.concatenate(numbers)
        stacked = StackedTable(int(self.step[0]) if len(self) else 0, **columns, scene=number)
        return Steps.split(self.step, number.searchsorted(np.arange(len(self) + 1)), stacked)

    def groups(self, agents: Collection[int]) -> Iterator[tuple[list[int], Steps]]:
        """Yields `agents`, ascending, in groups whose rows fit into about one block, each with the steps of only it."""
        ordered, rows = sorted(agents), max(1, int(self.begin[-1]))
        some = max(1, BLOCK_ROWS * len(self.ids) // rows)
        for k in range(0, len(ordered), some):
            yield ordered[k : k + some], self.only(ordered[k : k + some])

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

    def _part(self, index: int) -> AgentTable:
        """Returns the table of the step of that index, without copies."""
        rows = slice(self.begin[index], self.begin[index + 1])
        return AgentTable(int(self.step[index]), *(getattr(self.stacked, name)[rows] for name in ARRAY_FIELDS))

    def _after(self, step: int) -> Steps:
        """See :meth:`after`."""
        first = int(np.searchsorted(self.step, step, "right"))
        if not first:
            return self
        later = self.part(first, len(self))
        later._whole = self, first  # noqa: SLF001 - their tracks are parts of these
        return later

    def _split(self, begin: int, end: int, columns: Mapping[str, Any]) -> Steps:
        """Returns the steps of indices `begin` to `end` with rows of the arrays `columns`."""
        number = np.repeat(np.arange(end - begin), np.diff(self.begin[begin : end + 1]))
        stacked = StackedTable(int(self.step[begin]) if begin < end else 0, **columns, scene=number)
        return Steps.split(self.step[begin:end], self.begin[begin : end + 1] - self.begin[begin], stacked)


class StoredSteps(Steps):
    """Steps in a temporary file, for runs that are too long for the memory; all at once only as :attr:`stacked`."""

    def __init__(self, file: IO[bytes], step: IntArray, begin: IntArray, first: int = 0) -> None:
        """Makes the steps `step` (S,), whose tables begin at rows `begin` (S + 1,) behind the `first` row of `file`."""
        super().__init__(())
        vars(self).update(step=step, begin=begin, _tables=None)
        self._file, self._first = file, first

    def __iter__(self) -> Iterator[AgentTable]:
        for part in self.parts():
            yield from part

    @cached_property
    def stacked(self) -> StackedTable:
        """See :attr:`Steps.stacked`."""
        return self.part(0, len(self)).stacked

    @cached_property
    def ids(self) -> IntArray:
        """See :attr:`Steps.ids`."""
        ids = (np.unique(part.stacked.id) for part in self.parts())
        return np.unique(np.concatenate([np.empty(0, np.int64), *ids]))

    def part(self, begin: int, end: int) -> Steps:
        """See :meth:`Steps.part`."""
        begin, end = min(begin, len(self)), min(end, len(self))
        self._file.seek((self._first + int(self.begin[begin])) * ROW.itemsize)
        rows = np.frombuffer(self._file.read(int(self.begin[end] - self.begin[begin]) * ROW.itemsize), ROW)
        return self._split(begin, end, {name: np.ascontiguousarray(rows[name]) for name in ARRAY_FIELDS})

    def _part(self, index: int) -> AgentTable:
        return self.part(index, index + 1)[0]

    def _after(self, step: int) -> Steps:
        first = int(np.searchsorted(self.step, step, "right"))
        begin = self.begin[first:] - self.begin[first]
        return StoredSteps(self._file, self.step[first:], begin, self._first + int(self.begin[first]))


class StepsBuilder:
    """Collects tables in any order; those of long runs are in a temporary file."""

    def __init__(self) -> None:
        self._sizes: dict[int, int] = {}  # of the tables, by step
        self._file = SpooledTemporaryFile(BLOCK_ROWS * ROW.itemsize)  # noqa: SIM115 - closed with the steps

    def __len__(self) -> int:
        return len(self._sizes)

    def add(self, table: AgentTable) -> None:
        """Adds the table of a step; of several for one step, the first counts. Raises as :func:`write_temporary`."""
        if table.step in self._sizes:
            return
        self._sizes[table.step] = len(table)
        rows = np.empty(len(table), ROW)
        for name in ARRAY_FIELDS:
            rows[name] = getattr(table, name)
        write_temporary(self._file, rows.tobytes())

    def steps(self) -> Steps:
        """Returns the steps, ascending; in memory, if they are one block. The builder is of no use then."""
        step, size = (np.array([*values], np.int64) for values in (self._sizes, self._sizes.values()))
        steps = StoredSteps(self._file, step, np.cumsum([0, *size]))
        if (np.diff(step) < 0).any():
            ordered = StepsBuilder()
            for index in np.argsort(step).tolist():
                ordered.add(steps[index])
            return ordered.steps()
        return steps if len([*steps.blocks()]) > 1 else steps.part(0, len(steps))
