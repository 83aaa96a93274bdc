"""The past states of all agents as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray, index_of
from litsim_sim.kernels.compiled import Bools2, Floats3, Ints, OutBools2, OutFloats3, kernel


class History:
    """Some columns of the last `length` tables.

    Args:
        length: number of steps that are kept.
        fields: names of the columns; see :class:`.scene.AgentTable`.
    """

    def __init__(self, length: int, fields: Sequence[str]) -> None:
        self._length, self._fields = length, tuple(fields)
        self._restart()

    def _restart(self) -> None:
        self._step, self._held = 0, 0
        self._ids: IntArray = np.empty(0, np.int64)  # ascending: agents present in the steps that are held
        # Ring buffer: a step is in the row given by its number modulo `length`.
        self._values = np.zeros((self._length, 0, len(self._fields)))
        self._present = np.zeros((self._length, 0), np.bool_)

    def push(self, table: AgentTable) -> None:
        """Append a step; one that does not follow the last step clears the history."""
        if self._held and table.step != self._step + 1:
            self._restart()
        self._step, self._held = table.step, min(self._held + 1, self._length)
        row = table.step % self._length
        self._present[row] = False
        columns = index_of(self._ids, table.id)
        if (columns < 0).any():
            self._add_columns(table.id)
            columns = index_of(self._ids, table.id)
        self._present[row, columns] = True
        for k, name in enumerate(self._fields):
            self._values[row, columns, k] = getattr(table, name)

    def window(self, agents: IntArray, length: int, stride: int = 1) -> tuple[FloatArray, BoolArray]:
        """Returns the values of all fields for `agents` (m,) at `length` steps, `stride` apart, up to the newest.

        Returns:
            values (m, length, len(fields)) with zeros where an agent was absent or the history does not reach, and the
            mask (m, length) of where it was present; the newest step is the last.
        """
        back = stride * np.arange(length - 1, -1, -1)
        rows, columns = (self._step - back) % self._length, index_of(self._ids, agents)
        rows[back >= self._held] = -1
        values, valid = np.zeros((len(agents), length, len(self._fields))), np.zeros((len(agents), length), np.bool_)
        copy_window(self._values, self._present, rows, columns, values, valid)
        return values, valid

    def _add_columns(self, agents: IntArray) -> None:
        """Add columns for `agents` (m,), and remove those of agents that are in no step any more."""
        still = self._present.any(axis=0)
        ids = np.union1d(self._ids[still], agents)
        columns = np.searchsorted(ids, self._ids[still])
        values = np.zeros((self._length, len(ids), len(self._fields)))
        present = np.zeros((self._length, len(ids)), np.bool_)
        values[:, columns], present[:, columns] = self._values[:, still], self._present[:, still]
        self._ids, self._values, self._present = ids, values, present


@kernel
def copy_window(values: Floats3, present: Bools2, rows: Ints, columns: Ints, out: OutFloats3, valid: OutBools2) -> None:
    """Copy the values of m agents at h steps to `out` (m, h, f), and set `valid` (m, h) where there are any.

    `values` (s, a, f) and `present` (s, a) are of all steps and agents that are held, `rows` (h,) and `columns`
    (m,) those of the steps and agents asked for, below 0 for none.
    """
    for i in range(len(columns)):
        for t in range(len(rows)):
            if rows[t] >= 0 and columns[i] >= 0 and present[rows[t], columns[i]]:
                valid[i, t] = True
                for f in range(values.shape[2]):
                    out[i, t, f] = values[rows[t], columns[i], f]
