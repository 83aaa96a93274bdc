"""Where agents will be that keep turning and accelerating as they do now."""

from __future__ import annotations

import math

import numpy as np

from litsim_sim.core.scene import STEP_S, AgentArrays
from litsim_sim.kernels.compiled import Floats2, kernel

TURNING_MIN = 1.0  # [m/s] least speed at which the yaw rate defines the arc of an agent


@kernel
def arc_of(agents: AgentArrays, j: int, acceleration: float, steps: int) -> Floats2:
    """Returns where agent `j` is after each of `steps` (steps, 3), x, y [m], yaw [rad]; it accelerates until it stands.

    The `acceleration` is in [m/s2].
    """
    x, y, yaw, bend = agents.x[j], agents.y[j], agents.yaw[j], agents.yaw_rate[j] / max(agents.speed[j], TURNING_MIN)
    arc = np.empty((steps, 3))
    for k in range(steps):
        gone = STEP_S * max(agents.speed[j] + acceleration * STEP_S * (k + 1), 0.0)
        yaw += bend * gone
        x, y = x + gone * math.cos(yaw), y + gone * math.sin(yaw)
        arc[k, 0], arc[k, 1], arc[k, 2] = x, y, yaw
    return arc
