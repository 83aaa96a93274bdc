"""The two sides that the critic learns to tell apart: at the same moments, what was done and what the policy would do.

Were the policy's side taken from its own episodes, the critic could tell the sides by where they happened (another ego,
another flow, offsets from a path that in a recording is the driver's own) and never look at what is done. Here nothing
but the action differs. What comes of the actions is left to the penalties.

The policy is asked for what it draws, before the bounds on jerk: within those, a step of 0.1 s is hardly more than the
acceleration of the step before, and says next to nothing about who has chosen it.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from litsim_policy.driving.action import consistent, executed_yaw_rate, normalised, physical
from litsim_policy.driving.observation import SPEED
from litsim_policy.learning.network import GaussianPolicy
from litsim_policy.learning.ppo import Demonstrations, Track, tensor
from litsim_sim.core.scene import FloatArray


def critic_sides(
    policy: GaussianPolicy, recorded: Demonstrations, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw `count` moments that were `recorded`, with what drivers did there and what `policy` draws.

    Returns:
        observations and actions side by side (count, size + 3), of the drivers and of the policy, in the same order.
    """
    observation = recorded.observation[chosen := recorded.draw(count, generator)]
    raw, _ = policy.sample(observation, generator)
    sides = recorded.action[chosen], torch.tanh(raw)
    seen, (done, drawn) = observation.numpy(), (side.double().numpy() for side in sides)
    return _pairs(seen, done), _pairs(seen, drawn)


def driven_pairs(tracks: list[Track]) -> Tensor:
    """Observations and drawn actions side by side (m, size + 3) of all agent-steps, as the critic sees them.

    Steps on which an agent touched another or left the road are among them; the state after the last step is in none.
    """
    observation = np.concatenate([track.observation[:-1] for track in tracks])
    return _pairs(observation, np.tanh(np.concatenate([track.raw for track in tracks])))


def _pairs(observation: FloatArray, action: FloatArray) -> Tensor:
    """(m, size + 3) of both sides by side, the two lateral actions as the one turn that a vehicle makes of them."""
    speed, wanted = observation[:, 2] * SPEED, physical(action)
    made = normalised(consistent(wanted[:, 0], executed_yaw_rate(wanted, speed), speed))
    return tensor(np.concatenate([observation, made], axis=1))
