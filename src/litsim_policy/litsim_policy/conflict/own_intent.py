"""Own intent: an agent that can only not go back to its log since others ahead are slower than its log expects.

Its conflict is over then, and it drives on as it would without any: along the way of its log, as fast as its log or as
those ahead allow, by the headway of its own driver. It may pass, like anybody who is held up.
"""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import ConflictDetector
from litsim_policy.conflict.diverged import LANE, OWN_INTENT, DivergedNow
from litsim_policy.conflict.futures import Futures
from litsim_sim.core.scene import BoolArray, IntArray

# Chosen behind the tuning egos of us101_0750 (`idm`): 3 % of those who begin are held again, 5 % with half
# the time or twice the braking.
STEADY_STEPS = 20  # [steps] in a row for which an agent drives on steadily before that counts as its own intent
BRAKING = 0.5  # [m/s2] up to which it drives steadily
MOVES = 1.0  # [m/s] speed from which on it does: who stands is in somebody's queue, or waits for somebody to cross


def drive_by_own_intent(
    config: ConflictConfig, detector: ConflictDetector, now: DivergedNow, futures: Futures, pairs: IntArray
) -> BoolArray:
    """Returns the mask (r,) of agents off their logs that drive by their own intent, and count their steps in place.

    They do after STEADY_STEPS of steady driving, and until their own ways lead into conflicts with the second of their
    `pairs` (m, 2) for `ConflictConfig.confirm_steps`. Pedestrians and cyclists, who wait or walk, never do.
    """
    agents, table, rows = now.agents, now.table, now.rows
    own = agents.state == OWN_INTENT
    steady = (table.acceleration[rows] >= -BRAKING) & (now.speed >= MOVES) & ~table.obstacle[rows]
    asked = np.zeros(len(table), np.bool_)
    asked[rows[steady | own]] = True
    meets = detector.drive_into_conflict(futures, pairs[asked[futures.rows[pairs[:, 0]]]])[rows]
    run = np.where(steady & ~meets, np.maximum(agents.steady, 0) + 1, 0)
    agents.steady[:] = np.where(meets, np.minimum(agents.steady, 0) - 1, run)
    begins = (agents.steady >= STEADY_STEPS) & (agents.source != LANE)
    return np.asarray(np.where(own, agents.steady > -config.confirm_steps, begins))
