"""The two sides that the critic learns to tell apart: at the same moments, what was done and what the policy would do.

Were the policy's side taken from its own episodes, the critic could tell the sides by where they happened (another ego,
another flow, offsets from a path that in a recording is the driver's own) and never look at what is done. Here nothing
but the action differs. What comes of the actions is left to the penalties.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from litsim_policy.driving.action import consistent, executed_yaw_rate, normalised, physical
from litsim_policy.driving.observation import ACCELERATION, SPEED
from litsim_policy.driving.safety import LIMITS_ONLY
from litsim_policy.learning.network import GaussianPolicy
from litsim_policy.learning.ppo import Demonstrations
from litsim_sim.core.scene import STEP_S, FloatArray


def critic_sides(
    policy: GaussianPolicy, shown: Demonstrations, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw `count` moments of `shown`, with what drivers did there and what `policy` draws.

    Returns:
        observations and executed actions side by side (count, size + 3), of the drivers and of the policy. Both sides
        are in the same order; a vehicle's limits change both alike.
    """
    chosen = shown.draw(count, generator)
    observation = shown.observation[chosen]
    raw, _ = policy.sample(observation, generator)
    sides = (shown.action[chosen], torch.tanh(raw))
    seen = observation.double().numpy()
    executed = [torch.as_tensor(_executed(seen, side.double().numpy()), dtype=torch.float32) for side in sides]
    recorded, drawn = (torch.cat([observation, done], dim=1) for done in executed)
    return recorded, drawn


def _executed(observation: FloatArray, action: FloatArray) -> FloatArray:
    """What a vehicle does that observes `observation` (m, size) and is told `action`, both as actions (m, 3)."""
    speed, before = observation[:, 2] * SPEED, observation[:, 3] * ACCELERATION
    wanted, limits = physical(action), LIMITS_ONLY
    before = np.clip(before, -limits.deceleration_max, limits.acceleration_max)
    change = limits.jerk_max * STEP_S
    acceleration = np.clip(np.clip(wanted[:, 0], before - change, before + change), -limits.deceleration_max, None)
    acceleration = np.minimum(acceleration, limits.acceleration_max)
    return normalised(consistent(acceleration, executed_yaw_rate(wanted, speed), speed))
