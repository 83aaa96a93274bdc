"""Hand-back: driving an agent that is free of conflict back to its log, within comfort bounds.

Two ways, told apart by how late the log is that it goes back to (`Takeover.time_shift`):

- catch_up: the log as it is at the time, late by nothing. The agent makes up for what it has lost.
- time_shift: the log as it was where the agent is now. Only speed, offset and heading are left to meet, and the log is
  replayed with that lag from the release on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import FloatArray


@dataclass(frozen=True)
class HandbackConfig:
    """Bounded catch-up.

    Attributes:
        acceleration_max, deceleration_max: comfort bounds [m/s2]; those of nuPlan are 2.40 and 4.05.
        speed_excess: faster than the log by no more than this [m/s].
        position_gain: [1/s2].
        speed_gain: [1/s]; critically damped at twice the root of `position_gain`.
    """

    acceleration_max: float = 2.0
    deceleration_max: float = 3.0
    speed_excess: float = 4.0
    position_gain: float = 0.36
    speed_gain: float = 1.2


def catch_up(
    config: HandbackConfig,
    lag: float | FloatArray,
    speed: float | FloatArray,
    log_speed: float | FloatArray,
    log_acceleration: float | FloatArray,
) -> FloatArray:
    """Accelerations (...) [m/s2] that close `lag` (...), the distance [m] along the path by which the log is ahead.

    Args:
        config: bounds and gains.
        lag: [m].
        speed: of the agents [m/s].
        log_speed, log_acceleration: of their logs [m/s], [m/s2].
    """
    approach = np.clip(config.position_gain * lag / config.speed_gain, -config.speed_excess, config.speed_excess)
    wanted = log_acceleration + config.speed_gain * (log_speed + approach - speed)
    return np.asarray(np.clip(wanted, -config.deceleration_max, config.acceleration_max))
