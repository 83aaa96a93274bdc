"""The time gap that each driver usually keeps to the vehicle ahead, as seen while both are on their logs."""

from __future__ import annotations

import math

import numpy as np

from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.scene import AgentArrays, AgentTable, Controller, FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, Ints, kernel
from litsim_sim.scenario.log import Log

PERIOD = 5  # [steps] between two looks: time gaps change slowly
SIGHT = 60.0  # [m] farther ahead, nobody is followed
TIME_GAP_MAX = 3.0  # [s] with a longer gap, an agent drives on its own
SPEED_MIN = 2.0  # [m/s] slower than this, gaps say nothing about time
SAME_WAY = math.cos(math.pi / 6)  # cosine of the largest angle between the headings of an agent and its leader
LOG = int(Controller.LOG)


class UsualGaps:
    """Running means of the time gaps of all N agents of a log, from the steps seen so far.

    What an agent does once it is off its log, or behind one that is off its log, does not count: it is no record of the
    driver.
    """

    def __init__(self, log: Log) -> None:
        self._ids = log.ids
        self._looks, self._sum = np.zeros(len(log.ids)), np.zeros(len(log.ids))

    def observe(self, table: AgentTable) -> None:
        """Take the step of `table` into account; to be called once per step, in order."""
        if table.step % PERIOD:
            return
        gaps = time_gaps(table)
        follows = np.isfinite(gaps).nonzero()[0]
        at = self._ids.searchsorted(table.id[follows])
        self._looks[at] += 1.0
        self._sum[at] += gaps[follows]

    def means(self, agents: IntArray, typical: float, looks: float) -> FloatArray:
        """Returns the time gaps (m,) [s] that the drivers of `agents` (m,) keep, as far as known.

        The `typical` gap [s] counts as much as so many `looks`, of which one is taken every half second.
        """
        at = self._ids.searchsorted(agents)
        return np.asarray((typical * looks + self._sum[at]) / (looks + self._looks[at]))


def time_gaps(table: AgentTable) -> FloatArray:
    """Returns the time gap (n,) [s] of each agent to the one straight ahead, if both are on their logs, else inf.

    It is also inf for agents that stand or follow nobody.
    """
    rows = ((table.controller == LOG) & (table.speed > SPEED_MIN)).nonzero()[0]
    gaps = np.full(len(table), np.inf)
    gaps[rows] = _time_gaps(table.arrays, rows)
    return gaps


@kernel
def _time_gaps(agents: AgentArrays, rows: Ints) -> Floats:
    """See :func:`time_gaps`; of the agents in `rows` (m,)."""
    gaps, (begin, end) = np.full(len(rows), np.inf), within_scenes(agents.scene, rows)
    for i in range(len(rows)):
        own, least, leader = rows[i], SIGHT, -1
        cos, sin = math.cos(agents.yaw[own]), math.sin(agents.yaw[own])
        for j in range(begin[i], end[i]):
            dx, dy = agents.x[j] - agents.x[own], agents.y[j] - agents.y[own]
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            if not (0.0 < ahead < least and abs(left) < 0.5 * (agents.width[own] + agents.width[j])):
                continue
            if math.cos(agents.yaw[j] - agents.yaw[own]) > SAME_WAY:
                least, leader = ahead, j
        if leader >= 0 and agents.controller[leader] == LOG:
            gap = (least - 0.5 * (agents.length[own] + agents.length[leader])) / agents.speed[own]
            if 0.0 < gap < TIME_GAP_MAX:
                gaps[i] = gap
    return gaps
