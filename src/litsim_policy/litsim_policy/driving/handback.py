"""Hand-back: driving an agent that is free of conflict back to its log, within comfort bounds.

The lag of that log (`Takeover.time_shift`) distinguishes two ways:

- catch_up: no lag; the agent makes up for the time that it has lost.
- time_shift: the lag with which the log is nearest to the agent. Only speed, offset and heading remain to be matched,
  and the log is replayed with that lag from the release on.
"""

from __future__ import annotations

import numpy as np

from litsim_policy.motion.car_following import IdmConfig
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.scenario.log import Log

COMFORTABLE = IdmConfig(headway=0.8, standstill_gap=1.5, acceleration=2.0, deceleration=2.5)
"""Car following of agents off their logs."""


ACCELERATION_MAX, DECELERATION_MAX = 2.0, 3.0  # [m/s2] bounds of catching up; nuPlan's of comfort are 2.40 and 4.05
STANDING = 0.1  # [m/s] speed below which a log counts as standing
SPEED_EXCESS = 4.0  # [m/s] most by which an agent drives faster than its log
POSITION_GAIN = 0.36  # [1/s2] on the distance to the log
SPEED_GAIN = 1.2  # [1/s] on the difference in speed; twice the root of the other, for critical damping


def catch_up(
    behind: float | FloatArray,
    speed: float | FloatArray,
    log_speed: float | FloatArray,
    log_acceleration: float | FloatArray,
) -> FloatArray:
    """Returns accelerations (...) [m/s2] with which agents catch up with their logs, `behind` [m] along their paths.

    Slower than their logs, they brake less than these: as much as changes their speed as fast along the way.
    """
    approach = POSITION_GAIN * behind / SPEED_GAIN
    approach = np.minimum(np.maximum(approach, -SPEED_EXCESS), SPEED_EXCESS)
    share = np.minimum(speed / np.maximum(log_speed, STANDING), 1.0)
    with_log = np.where(np.less(log_acceleration, 0.0), log_acceleration * share**2, log_acceleration)
    wanted = with_log + SPEED_GAIN * (log_speed + approach - speed)
    return np.asarray(np.minimum(np.maximum(wanted, -DECELERATION_MAX), ACCELERATION_MAX))


def along_log(log: Log, agents: PathFollowers, lag: IntArray) -> tuple[FloatArray, FloatArray]:
    """Returns accelerations (m,) [m/s2] with which agents drive on as their logs do, and speeds (m,) [m/s] of these.

    The logs lag by `lag` (m,) steps; where one is over, its end counts.
    """
    rows = log.ids.searchsorted(agents.table.id[agents.rows])
    index = rows, np.minimum(agents.table.step - lag, log.last_step[rows])
    behind, speed = agents.to_goal(log.x[index], log.y[index]), log.speed[index]
    return catch_up(behind, agents.speed, speed, log.acceleration[index]), speed
