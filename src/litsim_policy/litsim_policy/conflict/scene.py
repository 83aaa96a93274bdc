"""The agents that are compared in one step, and their futures: only those near an agent off its log."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from litsim_policy.conflict.detection import Conflict, ConflictDetector
from litsim_policy.conflict.intended import Intents
from litsim_predictor.forecast import Forecast
from litsim_sim.core.scene import AgentTable, BoolArray, IntArray


class ConflictScene:
    """One step of detection. Masks are (n,), of all agents of the step.

    Futures are computed only within the ROI of agents for which conflicts are requested; the results are the same as
    with the futures of all agents.
    """

    def __init__(
        self,
        detector: ConflictDetector,
        table: AgentTable,
        forecast: Forecast,
        lag: IntArray,
        lagged: BoolArray,
        intents: Callable[[], Intents] | None = None,
    ) -> None:
        """Prepare the step; futures are computed when they are needed.

        Args:
            detector: compares futures.
            table: all n agents.
            forecast: of the same step.
            lag: (n,) steps by which the replay of each log lags.
            lagged: mask of agents that are expected to follow their logs, lag included: those on lagged logs, and
                pedestrians and cyclists.
            intents: the agents under control by now, rows ascending, and their paths; None for none.
        """
        self._detector, self._table, self._forecast = detector, table, forecast
        self._lag, self._lagged, self._intents = lag, lagged, intents
        self._covered = np.zeros(len(table), np.bool_)
        self._foreseen = np.zeros(len(table), np.bool_)
        self._rows: IntArray = np.empty(0, np.int64)

    def detect(self, on_log: BoolArray, off_log: BoolArray) -> list[Conflict]:
        """Conflicts of agents `on_log` with agents `off_log`; see :meth:`ConflictDetector.detect`."""
        self._cover(off_log, off_log)
        rows = self._rows
        return self._detector.detect(
            self._near, on_log[rows], off_log[rows], self._logged, self._expected, self._lag[rows]
        )

    def detect_behind(self, lagged: BoolArray, ahead: BoolArray) -> list[Conflict]:
        """Conflicts of agents on `lagged` logs with agents `ahead`; see :meth:`ConflictDetector.detect_behind`."""
        self._cover(lagged, np.zeros_like(lagged))
        rows = self._rows
        return self._detector.detect_behind(self._near, lagged[rows], ahead[rows], self._logged, self._lag[rows])

    def still_in_conflict(self, agents: BoolArray, off_log: BoolArray) -> BoolArray:
        """Mask of `agents` that would be in conflict; see :meth:`ConflictDetector.still_in_conflict`."""
        self._cover(agents, off_log)
        rows, found = self._rows, np.zeros(len(self._table), np.bool_)
        found[rows] = self._detector.still_in_conflict(
            self._near, agents[rows], off_log[rows], self._logged, self._expected, self._lag[rows]
        )
        return found

    def _cover(self, agents: BoolArray, off_log: BoolArray) -> None:
        """Compute the missing futures of `agents` and of all agents near them.

        Expected motions are computed of agents in the mask `off_log` only, logged ones of all.
        """
        missing = self._detector.near_any(self._table, agents) & ~self._covered
        nothing_yet = not len(self._rows)
        if nothing_yet or missing.any():
            self._covered |= missing
            self._rows = self._covered.nonzero()[0]
            self._near = self._table.take(self._rows)
            self._logged = self._detector.futures.logged(self._near, self._lag[self._rows])
        elif not (off_log & ~self._foreseen).any():
            return
        self._foreseen |= off_log
        rows, lagged = self._rows, self._lagged[self._rows]
        foreseen = self._foreseen & self._covered
        driven = None if self._intents is None else self._intents().among(foreseen & ~self._lagged).moved_to(rows)
        self._expected = self._detector.futures.expected(self._near, self._forecast, foreseen[rows] & ~lagged, driven)
        self._expected.put(lagged, self._logged)
