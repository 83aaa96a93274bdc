"""The pairs that the critic learns to tell apart: recorded actions, and the policy's in the same situations.

If the policy's pairs came from its own episodes, the critic could tell them apart by the situation (another ego, other
traffic, offsets from a path that in a recording is the driver's own) and ignore the action. Here only the action
differs. The consequences of actions are left to the penalties.

The policy's actions are what it draws, before the bounds on jerk: within these, the acceleration after a step of 0.1 s
is close to the one before, and says next to nothing about the driver.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from litsim_policy.driving.action import consistent, executed_yaw_rate, normalised, physical
from litsim_policy.driving.features.scales import SPEED
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.ppo import Demonstrations, Track, tensor
from litsim_sim.core.scene import FloatArray


def expert_and_policy_pairs(
    policy: GaussianPolicy, recorded: Demonstrations, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw `count` of the `recorded` pairs, and an action of `policy` for each of their observations.

    Returns:
        observations and actions side by side, (count, size + 3) of the drivers and of the policy, in the same order.
    """
    observation = recorded.observation[chosen := recorded.draw(count, generator)]
    raw, _ = policy.sample(observation, generator)
    expert, drawn = (action.double().numpy() for action in (recorded.action[chosen], torch.tanh(raw)))
    return _pairs(observation.numpy(), expert), _pairs(observation.numpy(), drawn)


def driven_pairs(tracks: list[Track]) -> Tensor:
    """Observations and drawn actions side by side (m, size + 3) of all agent-steps, as the critic sees them.

    Steps with a contact or off the road are included; the observation after the last step of a track is not.
    """
    observation = np.concatenate([track.observation[:-1] for track in tracks])
    return _pairs(observation, np.tanh(np.concatenate([track.raw for track in tracks])))


def _pairs(observation: FloatArray, action: FloatArray) -> Tensor:
    """Both side by side (m, size + 3), with the two lateral actions replaced by the turn that results from them."""
    speed, wanted = observation[:, 2] * SPEED, physical(action)
    made = normalised(consistent(wanted[:, 0], executed_yaw_rate(wanted, speed), speed))
    return tensor(np.concatenate([observation, made], axis=1))
