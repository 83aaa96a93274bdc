"""The environment `litsim/Takeover-v0` for many vehicles at once, several in each of several runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from litsim_policy.driving.action import ACTIONS
from litsim_policy.driving.task import NOBODY
from litsim_research.gym.common import STARTS, Array, Scenarios, action_space, loaded, observation_space, rewards
from litsim_research.policies.episodes import Course, EnvironmentConfig, Episodes
from litsim_research.policies.reward import PenaltyConfig
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, FloatArray


class TakeoverVectorEnvironment(VectorEnv[Array, Array, np.ndarray]):
    """Vehicles near deviating egos, `vehicles` in each of ``num_envs / vehicles`` runs that are stepped together.

    Observation, action and reward are those of :class:`.takeover.TakeoverEnvironment`, and so are the ends of a
    vehicle's episode, which lasts for `steps_max` steps at most. In the same step, another vehicle near that ego takes
    its place, from where it is; the former one goes back to its log. Once a run is over, or nobody near its ego is
    left, all runs begin anew, with one of the scenarios and other egos, and the episodes are truncated.

    Args:
        num_envs: number of vehicles.
        scenario: what is drawn for all runs each time that they begin.
        vehicles: number of vehicles in each run; they meet each other.
        steps_max: most steps of an episode.
        radius: distance from the ego within which vehicles are drawn [m].
        progress: reward for each metre driven.
        penalty: weights of the penalties.

    Raises:
        InputError: `num_envs` is no multiple of `vehicles`.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012 - as in the base class

    def __init__(
        self,
        num_envs: int = 64,
        scenario: Scenarios = "demo",
        *,
        vehicles: int = 8,
        steps_max: int = 100,
        radius: float = 50.0,
        progress: float = 0.1,
        penalty: PenaltyConfig | None = None,
    ) -> None:
        if num_envs % vehicles:
            raise InputError(f"num_envs is {num_envs}, expected a multiple of vehicles ({vehicles})")
        scenarios = loaded(scenario)
        longest = max(entry.total_steps for entry in scenarios)
        config = EnvironmentConfig(longest, vehicles, vehicles, radius, longest)
        self._course = Course(scenarios, config, penalty=penalty or PenaltyConfig())
        self._runs, self._steps_max, self._progress = num_envs // vehicles, steps_max, progress
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self._course.observation.size)
        self.single_action_space = action_space(len(ACTIONS))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes: Episodes

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin all runs anew, where their histories end; `options` are not used.

        Raises:
            InputError: there are not as many vehicles near the egos, whichever starts are drawn.
        """
        super().reset(seed=seed, options=options)
        self._begin()
        return self._seen().astype(np.float32), self._info()

    def step(self, actions: Array) -> tuple[Array, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive the vehicles by `actions` (num_envs, 3) for a step of 0.1 s.

        Returns:
            observations (num_envs, size), rewards, terminated, truncated (num_envs,), and information: the vehicles'
            ids, and as `final_obs` the last observations of episodes that are over. Raises as :meth:`reset`.
        """
        outcome = self._episodes.step(np.asarray(actions, np.float64)[self._agents.argsort()])
        self._steps += 1
        rows = outcome.agents.searchsorted(self._agents)
        following, terminated = outcome.following[rows], outcome.terminated[rows]
        reward = rewards(self._progress, following, outcome.penalty[rows])
        over = terminated | ~outcome.driven_on[rows] | (self._steps >= self._steps_max)
        if over.any() and not self._exchange(over):
            over = np.ones(self.num_envs, np.bool_)
            self._begin()
        info = self._info() | {"final_obs": following.astype(np.float32), "_final_obs": over}
        return self._seen().astype(np.float32), reward, terminated, over & ~terminated, info

    def _begin(self) -> None:
        """Begin all runs, with one scenario, since runs that are stepped together share a net."""
        for _ in range(STARTS):
            course = replace(self._course, scenarios=[self._course.scenario(self.np_random)])
            starts = [course.start(self.np_random) for _ in range(self._runs)]
            self._episodes = Episodes(course, starts, sampled_only=True, failure_ends=False)
            if len(self._episodes.driven) == self.num_envs:
                self._agents, self._steps = self._episodes.driven, np.zeros(self.num_envs, np.int64)
                return
        wanted = f"{course.config.sampled} vehicles within {course.config.sample_radius:g} m of each ego"
        raise InputError(f"litsim/Takeover-v0: there are no {wanted} at {STARTS} starts; expected denser traffic")

    def _exchange(self, over: BoolArray) -> bool:
        """Have others take the places of the vehicles in the mask `over` (num_envs,); returns whether there are any."""
        if not self._episodes.running.all():
            return False
        others = self._episodes.exchange(self._agents[over])
        self._agents, self._steps = self._agents.copy(), np.where(over, 0, self._steps)
        self._agents[over] = others
        return bool((others != NOBODY).all())

    def _seen(self) -> FloatArray:
        """Returns the observations (num_envs, size) of the vehicles."""
        return self._episodes.seen[self._episodes.driven.searchsorted(self._agents)]

    def _info(self) -> dict[str, Any]:
        recorded = self._episodes.batch.log.recorded_ids[self._agents]
        return {"agent": recorded, "_agent": np.ones(self.num_envs, np.bool_)}
