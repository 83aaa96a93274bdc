"""Habits of drivers: the headway that each usually keeps, as recorded up to now."""

from __future__ import annotations

import numpy as np

from litsim_policy.motion.log_leaders import LogColumns, columns_of, lay_way, logged_leader
from litsim_policy.motion.speed_change import USUAL_HEADWAY
from litsim_sim.kernels.compiled import OutFloats2, kernel
from litsim_sim.scenario.log import Log

WINDOW, STRIDE = 100, 5  # [steps] before the first question over which a headway is taken, and between its samples
GAP_MAX, SPEED_MIN = 60.0, 2.0  # [m], [m/s] gap up to which, and speed from which, a headway counts
PRIOR = 6.0  # samples that USUAL_HEADWAY counts for


class Habits:
    """The usual headways of the drivers of a log, each learned from its own record while that goes on.

    Attributes:
        columns: of the log.
        seen: (n, 3) by row of the log: sum [s] and number of headways, and the step up to which they count.
    """

    def __init__(self, log: Log) -> None:
        self.columns, self.seen = columns_of(log), np.zeros((len(log.ids), 3))
        self.seen[:, 2] = -STRIDE


@kernel
def usual_headway(log: LogColumns, row: int, step: int, seen: OutFloats2, way: OutFloats2) -> float:
    """Returns the usual headway [s] of one driver; `way` (VERTICES, 5) is overwritten. See :class:`Habits`."""
    first = max(int(seen[row, 2]) + STRIDE, step - WINDOW, log.first_step[row])
    for t in range(first, step + 1, STRIDE):
        count = lay_way(log, row, t, way)
        leader, speed = logged_leader(way, count, log, row, t), log.speed[row, t]
        seen[row, 2] = t
        if 0.0 < leader.gap < GAP_MAX and speed >= SPEED_MIN:
            seen[row, 0] += leader.gap / speed
            seen[row, 1] += 1.0
    return (USUAL_HEADWAY * PRIOR + seen[row, 0]) / (PRIOR + seen[row, 1])
