"""Pairs of agents whose boxes overlap in the log itself, as in queues of vehicles with default sizes."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.geometry import boxes_overlap
from litsim_sim.core.scene import RATE_HZ, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.log import Log

ABOUT_THEN = round(1.0 * RATE_HZ)  # [steps] by which an overlap in the log may be earlier or later
ON_THE_WAY = round(3.0 * RATE_HZ)  # [steps] by which it may be later for an agent on the way into it
IN_PLACE = 1.0  # [m] distance from its logged position within which an agent is in place


class LogOverlaps:
    """Distinguishes overlaps that are in the log from new ones; pairs are computed on demand."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._steps: dict[tuple[int, int], IntArray] = {}  # of a pair, by its lower row and then its higher one

    def steps(self, a: int, b: int) -> IntArray:
        """Returns the steps (k,) of the log, ascending, at which boxes of the agents in rows `a` and `b` overlap."""
        pair = (a, b) if a < b else (b, a)
        if pair not in self._steps:
            self._steps[pair] = self._find(*pair)
        return self._steps[pair]

    def any(self, pairs: IntArray) -> BoolArray:
        """Returns whether the boxes of each of `pairs` (m, 2), rows of the log, overlap at any step (m,)."""
        return np.array([len(self.steps(a, b)) > 0 for a, b in pairs.tolist()], np.bool_)

    def exempt(self, a: int, b: int, now: IntArray, x: FloatArray, y: FloatArray, later: int = ABOUT_THEN) -> BoolArray:
        """Returns whether rows a and b of the log overlap near steps `now` (m,), with b at its logged position (m,).

        `x`, `y` (m,) are positions of b [m]. The overlap may be `later` by so many steps, and ABOUT_THEN
        earlier.
        """
        meeting = self.steps(a, b)
        if not len(meeting):
            return np.zeros(len(now), np.bool_)
        then = (meeting >= now[:, None] - ABOUT_THEN) & (meeting <= now[:, None] + later)
        off = np.hypot(self._log.x[b, meeting] - x[:, None], self._log.y[b, meeting] - y[:, None])
        return np.asarray((then & (off <= IN_PLACE)).any(axis=1))

    def meets(self, a: int, b: int, now: int, x: float, y: float) -> bool:
        """Returns whether row a, on the way to its place at step `now`, meets row b at `x`, `y` [m] as in the log."""
        if not len(self.steps(a, b)):
            return False
        return bool(self.exempt(a, b, np.array([now]), np.array([x]), np.array([y]), ON_THE_WAY)[0])

    def _find(self, a: int, b: int) -> IntArray:
        log = self._log
        both = np.flatnonzero(log.valid[a] & log.valid[b])
        hit = boxes_overlap(
            log.x[b, both] - log.x[a, both],
            log.y[b, both] - log.y[a, both],
            log.yaw[a, both],
            log.yaw[b, both],
            (log.length[a], log.width[a]),
            (log.length[b], log.width[b]),
        )
        return both[hit]
