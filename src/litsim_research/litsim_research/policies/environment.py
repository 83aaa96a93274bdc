"""The environment in which policy C is trained, with gymnasium's interface to one episode.

Several agents share one policy: an observation and an action have a row for each of `slots`, and ``info["agents"]``
contains the id of each row's agent. Training itself drives :class:`.episodes.Episodes`, which this class wraps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.features.scales import LIMIT
from litsim_policy.driving.safety.config import LIMITS_ONLY, SafetyConfig
from litsim_research.policies.episodes import Course, EnvironmentConfig, Episodes
from litsim_research.policies.reward import PenaltyConfig
from litsim_sim.core.scene import IntArray
from litsim_sim.scenario.scenario import Scenario

Array = np.ndarray
EMPTY = -1  # id in an empty slot


class PolicyEnvironment(gymnasium.Env[Array, Array]):
    """Episodes on `scenarios`; the ego, its deviation and the drafted agents are drawn by the seed.

    An episode is terminated when a driven agent collides or leaves the road, and truncated when its time is up. Steps
    without a driven agent are skipped.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as in the base class

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        config: EnvironmentConfig | None = None,
        observation: ObservationConfig | None = None,
        penalty: PenaltyConfig | None = None,
        safety: SafetyConfig = LIMITS_ONLY,
    ) -> None:
        self.config = config or EnvironmentConfig()
        self.course = Course(
            list(scenarios), self.config, observation or ObservationConfig(), penalty or PenaltyConfig(), safety
        )
        slots, size = self.config.slots, self.course.observation.size
        self.observation_space = gymnasium.spaces.Box(-LIMIT, LIMIT, (slots, size), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (slots, 3), np.float64)
        self.scenario: Scenario

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin a new episode, up to the first step with a driven agent; `options` are not used."""
        super().reset(seed=seed, options=options)
        start = self.course.start(self.np_random)
        self.scenario, self._episodes = start.scenario, Episodes(self.course, [start])
        self._pass_by()
        return self._observations(), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive the agents in the slots by `action` (slots, 3) in [-1, 1].

        Returns:
            observation (slots, size), mean penalty of the driven agents, terminated, truncated, and info: `agents`
            (slots,), EMPTY in empty slots, `step`, `scenario` and `outcome` (:class:`.episodes.Outcome`).
        """
        outcome = self._episodes.step(np.asarray(action, np.float64)[: len(self._episodes.driven)])
        terminated = bool(outcome.terminated.any())
        self._pass_by()
        reward = float(outcome.penalty.mean()) if len(outcome.agents) else 0.0
        truncated = not terminated and not self._episodes.running[0]
        outcome = replace(outcome, agents=self._own(outcome.agents))
        return self._observations(), reward, terminated, truncated, self._info() | {"outcome": outcome}

    def _pass_by(self) -> None:
        """Step until an agent is driven or the episode is over."""
        while self._episodes.running[0] and not len(self._episodes.driven):
            self._episodes.step(np.empty((0, 3)))

    def _own(self, agents: IntArray) -> IntArray:
        """Ids in the recording for `agents`, ids in the joined scenario."""
        return self._episodes.joined.own(0, agents)

    def _observations(self) -> Array:
        """Observations (slots, size) of the driven agents; zeros in empty slots."""
        observation = np.zeros(self.observation_space.shape or ())
        observation[: len(self._episodes.seen)] = self._episodes.seen
        return observation

    def _info(self) -> dict[str, Any]:
        agents = np.full(self.config.slots, EMPTY, np.int64)
        driven = self._own(self._episodes.driven)
        agents[: len(driven)] = driven
        return {"agents": agents, "step": self._episodes.step_number, "scenario": self.scenario.name}
