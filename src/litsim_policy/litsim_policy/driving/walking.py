"""How walkers and cyclists are driven: on as their logs do, and to a stop before those in their way.

Their accelerations are the defaults of SUMO for persons and bicycles (`accel` and `decel` of its vehicle types), which
are meant to be convenient: walkers at 1.4 m/s stop within 0.7 s and half a metre.
"""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.walking import WaysAhead
from litsim_policy.driving.handback import along_log
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.scene import FloatArray, IntArray, Kind
from litsim_sim.scenario.log import Log

ACCELERATIONS = {Kind.PEDESTRIAN: 1.5, Kind.BICYCLE: 1.2}  # [m/s2]
DECELERATIONS = {Kind.PEDESTRIAN: 2.0, Kind.BICYCLE: 3.0}  # [m/s2]
STOPS_WITHIN = 0.01  # [m] free distance from which on all of that deceleration is used


def walk(log: Log, agents: PathFollowers, lag: IntArray) -> FloatArray:
    """Returns accelerations (m,) [m/s2] of walkers and cyclists whose logs lag by `lag` (m,) steps.

    Before whoever is in their way they brake constantly, by what stops them there.
    """
    ways = WaysAhead.of(log, agents.table, agents.rows, lag)
    walks = agents.table.kind[agents.rows] == int(Kind.PEDESTRIAN)
    acceleration = np.where(walks, ACCELERATIONS[Kind.PEDESTRIAN], ACCELERATIONS[Kind.BICYCLE])
    deceleration = np.where(walks, DECELERATIONS[Kind.PEDESTRIAN], DECELERATIONS[Kind.BICYCLE])
    needed = np.where(ways.room > STOPS_WITHIN, 0.5 * agents.speed**2 / np.maximum(ways.room, STOPS_WITHIN), np.inf)
    onwards, _ = along_log(log, agents, lag)
    wanted = np.where(ways.blocker >= 0, np.minimum(onwards, -needed), onwards)
    return np.asarray(np.clip(wanted, -deceleration, acceleration))
