"""What the environments have in common: spaces, scenarios, and the reward."""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium
import numpy as np
from numpy.typing import NDArray

from litsim_policy.driving.features.scales import LIMIT, SPEED
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.scenario.scenario import Scenario

AT_SPEED = 2  # position of the speed in every observation
STARTS = 100  # most starts that are drawn for an episode

Array = NDArray[np.float32]
Scenarios = str | Scenario | Sequence[str | Scenario]
"""The name of a packaged scenario, a YAML file, or a scenario; or several, of which each episode draws one."""


def observation_space(size: int) -> gymnasium.Space[Array]:
    """Returns the space of observations with `size` features."""
    return gymnasium.spaces.Box(-LIMIT, LIMIT, (size,), np.float32)


def action_space(size: int) -> gymnasium.Space[Array]:
    """Returns the space of actions with `size` parts, each a share of what a vehicle may do."""
    return gymnasium.spaces.Box(-1.0, 1.0, (size,), np.float32)


def loaded(scenario: Scenarios) -> list[Scenario]:
    """Returns the scenarios; raises InputError if one cannot be used."""
    several = [scenario] if isinstance(scenario, str | Scenario) else scenario
    return [entry if isinstance(entry, Scenario) else Scenario.load(entry) for entry in several]


def rewards(progress: float, observation: FloatArray, penalty: FloatArray) -> FloatArray:
    """Returns the rewards (m,) of a step.

    Args:
        progress: reward for each metre driven.
        observation: (m, size) after the step.
        penalty: (m,) weighted sums of the penalties of the step, at most 0.
    """
    return progress * observation[:, AT_SPEED] * SPEED * STEP_S + penalty
