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
from litsim_policy.motion.stop_lines import StopLines, idm_at_signals
from litsim_sim.core.quantities import Acceleration, Positive, Rate, Speed, SquaredRate, configuration
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.setting import Setting

COMFORTABLE = IdmConfig(headway=0.8, standstill_gap=1.5, acceleration=2.0, deceleration=2.5)
"""Car following of agents off their logs."""


@configuration
class HandbackConfig:
    """Bounded catch-up.

    Attributes:
        acceleration_max, deceleration_max: comfort bounds; those of nuPlan are 2.40 and 4.05.
        speed_excess: most by which an agent drives faster than the log.
        position_gain: gain on the distance to the log.
        speed_gain: gain on the difference in speed; twice the root of `position_gain` for critical damping.
    """

    acceleration_max: Positive[Acceleration] = 2.0
    deceleration_max: Positive[Acceleration] = 3.0
    speed_excess: Positive[Speed] = 4.0
    position_gain: Positive[SquaredRate] = 0.36
    speed_gain: Positive[Rate] = 1.2


def catch_up(
    config: HandbackConfig,
    behind: float | FloatArray,
    speed: float | FloatArray,
    log_speed: float | FloatArray,
    log_acceleration: float | FloatArray,
) -> FloatArray:
    """Returns accelerations (...) [m/s2] with which agents catch up with their logs.

    Args:
        config: bounds and gains.
        behind: distance along the path to the log's position [m].
        speed: of the agents [m/s].
        log_speed, log_acceleration: of their logs [m/s], [m/s2].
    """
    approach = config.position_gain * behind / config.speed_gain
    approach = np.minimum(np.maximum(approach, -config.speed_excess), config.speed_excess)
    wanted = log_acceleration + config.speed_gain * (log_speed + approach - speed)
    return np.asarray(np.minimum(np.maximum(wanted, -config.deceleration_max), config.acceleration_max))


def along_log(config: HandbackConfig, log: Log, agents: PathFollowers, lag: IntArray) -> FloatArray:
    """Returns accelerations (m,) [m/s2] with which agents drive on as their logs do, `lag` (m,) steps later.

    Where the log is over, its end counts.
    """
    rows = log.ids.searchsorted(agents.table.id[agents.rows])
    at = rows, np.minimum(agents.table.step - lag, log.last_step[rows])
    behind = agents.to_goal(log.x[at], log.y[at])
    return catch_up(config, behind, agents.speed, log.speed[at], log.acceleration[at])


class OwnLogs:
    """Logs as something that drives: on as the own log does, with a lag, but not over red lights.

    Attributes:
        log: of all agents.
    """

    def __init__(self, scenario: Setting) -> None:
        self.log, self._stop_lines = scenario.log, StopLines(scenario.signals)

    def onwards(self, agents: PathFollowers, lag: IntArray) -> FloatArray:
        """Returns accelerations (m,) [m/s2] of agents whose logs lag by `lag` (m,) steps."""
        acceleration = along_log(HandbackConfig(), self.log, agents, lag)
        free = np.full(len(agents), COMFORTABLE.desired_speed)
        return idm_at_signals(COMFORTABLE, agents.speed, free, acceleration, self._stop_lines.of(agents))
