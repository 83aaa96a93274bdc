"""Conflicts by hindsight: overlaps of logs with agents off their logs, in an earlier run of the same case."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.futures import Futures
from litsim_sim.core.scene import STEP_S, BoolArray
from litsim_sim.scenario.outcomes import RecordedOutcomes
from litsim_sim.scenario.setting import Setting


class Hindsight:
    """Reports each contact that a log would have had, as soon as it is within the horizon."""

    def __init__(self, scenario: Setting, folder: Path, horizon: float) -> None:
        """Read the outcomes of `scenario` from `folder`; `horizon` [s].

        Raises:
            InputError: see :meth:`RecordedOutcomes.read`.
        """
        self._log = scenario.log
        self._steps = int(horizon / STEP_S + 1e-9)
        self._meetings = RecordedOutcomes.read(folder, scenario).meetings

    def conflicts(self, futures: Futures, on_log: BoolArray, diverged: BoolArray) -> list[Conflict]:  # noqa: ARG002 - of the interface
        """Returns conflicts of agents `on_log` (mask (n,)), soonest first, one for each agent.

        As :meth:`.detector.ConflictDetector.conflicts`, but whatever agents do now or are expected to do.
        """
        table, ids, log = futures.table, self._log.ids, self._log
        row, step, other = self._meetings.T
        soon = (step > table.step) & (step <= table.step + self._steps)
        soon &= np.isin(row, np.searchsorted(ids, table.id[on_log]))
        conflicts: dict[int, Conflict] = {}
        for k in np.flatnonzero(soon)[np.argsort(step[soon], kind="stable")].tolist():
            at = row[k], step[k]
            pose = np.array([log.x[at], log.y[at], log.yaw[at]])
            ahead = float(step[k] - table.step) * STEP_S
            agent = int(ids[row[k]])
            conflicts.setdefault(agent, Conflict(agent, int(ids[other[k]]), ahead, pose, 1.0))
        return list(conflicts.values())
