"""Hand-back: driving an agent that is free of conflict back to its log, within comfort bounds.

Two ways, told apart by the lag of the log that it goes back to (`Takeover.time_shift`):

- catch_up: the log as it is at the time, without any lag. The agent makes up for what it has lost.
- time_shift: the log as it was where the agent is now. Only speed, offset and heading are left to meet, and the log is
  replayed with that lag from the release on.
"""

from __future__ import annotations

import numpy as np

from litsim_sim.core.quantities import Acceleration, Positive, Rate, Speed, SquaredRate, configuration
from litsim_sim.core.scene import FloatArray


@configuration
class HandbackConfig:
    """Bounded catch-up.

    Attributes:
        acceleration_max, deceleration_max: comfort bounds; those of nuPlan are 2.40 and 4.05.
        speed_excess: faster than the log by no more than this.
        position_gain: of the acceleration on the distance to make up for.
        speed_gain: of the acceleration on the difference in speed; critically damped at twice the root of
            `position_gain`.
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
    """Accelerations (...) [m/s2] that close the distance `behind` (...) by which the log is ahead along the path.

    Args:
        config: bounds and gains.
        behind: distance along the path to where the log is [m].
        speed: of the agents [m/s].
        log_speed, log_acceleration: of their logs [m/s], [m/s2].
    """
    approach = config.position_gain * behind / config.speed_gain
    approach = np.minimum(np.maximum(approach, -config.speed_excess), config.speed_excess)
    wanted = log_acceleration + config.speed_gain * (log_speed + approach - speed)
    return np.asarray(np.minimum(np.maximum(wanted, -config.deceleration_max), config.acceleration_max))
