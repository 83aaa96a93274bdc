"""The environment `litsim/Takeover-v0`: drive one vehicle of the background in the closed loop."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from litsim_policy.driving.action import ACTIONS
from litsim_research.gym.common import STARTS, Array, Scenarios, action_space, loaded, observation_space, rewards
from litsim_research.policies.episodes import Course, EnvironmentConfig, Episodes
from litsim_research.policies.reward import PenaltyConfig
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import Scenario

NAME = "litsim/Takeover-v0"


class TakeoverEnvironment(gymnasium.Env[Array, Array]):
    """One vehicle near a deviating ego, off its log from the start, in the loop that runs use.

    The observation is policy C's (:mod:`litsim_policy.driving.features.observation`). The action is longitudinal
    acceleration, lateral acceleration and yaw rate, each in [-1, 1] of what the policy may do. Other agents are
    replayed, and those that are taken over driven by policy yield. The reward of a step is `progress` times the
    distance driven [m], less the penalties. An episode is terminated when the vehicle collides or leaves the road, and
    truncated when it leaves the net or the time is up.

    Args:
        scenario: what an episode draws its scenario from.
        steps_max: most steps of an episode.
        radius: distance from the ego within which the vehicle is drawn [m].
        progress: reward for each metre driven.
        penalty: weights of the penalties.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as in the base class

    def __init__(
        self,
        scenario: Scenarios = "demo",
        *,
        steps_max: int = 100,
        radius: float = 50.0,
        progress: float = 0.1,
        penalty: PenaltyConfig | None = None,
    ) -> None:
        config = EnvironmentConfig(steps_max, slots=1, sampled=1, sample_radius=radius, sample_steps=steps_max)
        self._course = Course(loaded(scenario), config, penalty=penalty or PenaltyConfig())
        self._progress = progress
        self.observation_space = observation_space(self._course.observation.size)
        self.action_space = action_space(len(ACTIONS))
        self._episodes: Episodes
        self._scenario: Scenario

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin a new episode, where the history ends; `options` are not used.

        Raises:
            InputError: nobody is near the ego, whichever start is drawn.
        """
        super().reset(seed=seed, options=options)
        for _ in range(STARTS):
            start = self._course.start(self.np_random)
            self._scenario, self._episodes = start.scenario, Episodes(self._course, [start], sampled_only=True)
            if len(self._episodes.driven):
                return self._episodes.seen[0].astype(np.float32), self._info(int(self._episodes.driven[0]))
        raise InputError(f"{NAME}: nobody to drive at {STARTS} starts; expected traffic around the ego")

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive the agent by `action` (3,) for a step of 0.1 s.

        Returns:
            observation, reward, whether the episode is terminated, or truncated, and information: the agent's id, the
            step, the name of the scenario, and `outcome` (:class:`.episodes.Outcome`).
        """
        outcome = self._episodes.step(np.asarray(action, np.float64)[None])
        following, terminated = outcome.following[0], bool(outcome.terminated[0])
        reward = float(rewards(self._progress, outcome.following, outcome.penalty)[0])
        truncated = not terminated and not bool(outcome.driven_on[0])
        info = self._info(int(outcome.agents[0])) | {"outcome": outcome}
        return following.astype(np.float32), reward, terminated, truncated, info

    def _info(self, agent: int) -> dict[str, Any]:
        own = int(self._episodes.batch.log.recorded_ids[agent])
        return {"agent": own, "step": self._episodes.step_number, "scenario": self._scenario.name}
