"""The headway that each driver keeps: that with which the Intelligent Driver Model drives as the driver did so far."""

from __future__ import annotations

import numpy as np

from litsim_policy.motion.car_following import IdmValues, headway_kept
from litsim_policy.motion.log_leaders import BACK, VERTICES, LogColumns, columns_of, lay_way, logged_leader
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import STEP_S, FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, Ints, kernel
from litsim_sim.scenario.log import Log

WINDOW, STRIDE = 100, 5  # [steps] over which a driver is looked at, and between two looks
SPEED_MIN = 2.0  # [m/s] slower than this, gaps say little about headways
TIME_GAP_MAX = 4.0  # [s] with a longer gap, a driver follows nobody
HEADWAY_MIN, HEADWAY_MAX = 0.1, 3.0  # [s] limits on what one look tells
UNKNOWN = -1  # in place of a step


class KeptHeadways:
    """The headways of the drivers of a log, each from its own record up to the step at which it leaves that."""

    def __init__(self, log: Log, model: IdmValues, looks: float) -> None:
        """The headway of `model` counts as much as so many `looks` at a driver, of which one is taken every 0.5 s."""
        self._ids, self._columns, self._model, self._looks = log.ids, columns_of(log), model, looks
        self._until, self._headway = np.full(len(log.ids), UNKNOWN), np.zeros(len(log.ids))

    def of(self, agents: IntArray, until: IntArray) -> FloatArray:
        """Returns the headways (m,) [s] of the drivers of `agents` (m,), from their records up to steps `until`."""
        rows = self._ids.searchsorted(agents)
        new = (self._until[rows] != until).nonzero()[0]
        if len(new):
            self._headway[rows[new]] = _headways(self._columns, rows[new], until[new], self._model, self._looks)
            self._until[rows[new]] = until[new]
        return self._headway[rows]


@kernel
def headway_of_look(speed: float, change: float, gap: float, leader_speed: float, model: IdmValues) -> float:
    """Returns the headway [s] that one look at a driver tells; 0 if the driver follows nobody.

    `change` is that of the speed over the half second before [m/s].
    """
    if not (speed > SPEED_MIN and 0.0 < gap < TIME_GAP_MAX * speed):
        return 0.0
    headway = headway_kept(speed, change / (BACK * STEP_S), gap, leader_speed, model)
    return within(headway, HEADWAY_MIN, HEADWAY_MAX)


@kernel
def _headways(log: LogColumns, rows: Ints, until: Ints, model: IdmValues, looks: float) -> Floats:
    """See :meth:`KeptHeadways.of`; for the agents in `rows` (m,) of the log."""
    headways, way = np.empty(len(rows)), np.empty((VERTICES, 5))
    for k in range(len(rows)):
        row, count, total = rows[k], looks, looks * model.headway
        last = min(until[k], log.last_step[row])
        for t in range(last, max(last - WINDOW, log.first_step[row]) - 1, -STRIDE):
            leader = logged_leader(way, lay_way(log, row, t, way), log, row, t)
            speed = log.speed[row, t]
            change = speed - log.speed[row, max(t - BACK, log.first_step[row])]
            headway = headway_of_look(speed, change, leader.gap, leader.speed, model)
            if headway > 0.0:
                count, total = count + 1.0, total + headway
        headways[k] = total / count
    return headways
