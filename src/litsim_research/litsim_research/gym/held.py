"""The environment of all agents that are taken over in a run, by PettingZoo's interface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from litsim_policy.driving.action import ACTIONS
from litsim_research.gym.common import STARTS, Array, Scenarios, action_space, loaded, observation_space, rewards
from litsim_research.policies.episodes import Course, EnvironmentConfig, Episodes
from litsim_research.policies.reward import PenaltyConfig
from litsim_sim.core.errors import InputError

Results = tuple[dict[str, Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]


class HeldEnvironment(ParallelEnv):
    """The agents off their logs in a run around a deviating ego, from takeover to hand-back.

    Each takeover is an agent with a name of its own, so that agents come and go. Observation, action and reward are
    those of :class:`.takeover.TakeoverEnvironment`. An agent is terminated when it collides, leaves the road, is handed
    back or leaves the net. All are truncated when the run is over: at its last step, once one has collided or left the
    road, or with the first takeover that no name is left for. Steps in which nobody is off the log are passed over.

    Args:
        scenario: what an episode draws its scenario from.
        takeovers: number of names.
        slots: most agents at a time; policy `yield` drives further ones.
        steps_max: most steps of a run after its history.
        progress: reward for each metre driven.
        penalty: weights of the penalties.
    """

    metadata = {"name": "litsim_held_v0", "render_modes": []}  # noqa: RUF012 - as in the base class

    def __init__(
        self,
        scenario: Scenarios = "demo",
        *,
        takeovers: int = 64,
        slots: int = 10,
        steps_max: int = 300,
        progress: float = 0.1,
        penalty: PenaltyConfig | None = None,
    ) -> None:
        config = EnvironmentConfig(steps_max, slots, sampled=0, handback_ends=True)
        self._course = Course(loaded(scenario), config, penalty=penalty or PenaltyConfig())
        self._progress = progress
        self.possible_agents = [f"agent_{number}" for number in range(takeovers)]
        self.agents: list[str] = []
        self._observed, self._acted = observation_space(self._course.observation.size), action_space(len(ACTIONS))
        self._random = seeding.np_random(None)[0]

    def observation_space(self, agent: str) -> gymnasium.Space[Array]:  # noqa: ARG002 - the same for all
        """Returns the space of observations."""
        return self._observed

    def action_space(self, agent: str) -> gymnasium.Space[Array]:  # noqa: ARG002 - the same for all
        """Returns the space of actions."""
        return self._acted

    def reset(
        self,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002 - of the interface
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Begin a new run, at the first step with an agent off its log; `options` are not used.

        Raises:
            InputError: nobody is taken over, whichever start is drawn.
        """
        if seed is not None:
            self._random = seeding.np_random(seed)[0]
        for _ in range(STARTS):
            self._episodes = Episodes(self._course, [self._course.start(self._random)])
            self._names: dict[int, str] = {}
            self._unused = list(reversed(self.possible_agents))
            self._go_on()
            if self.agents:
                return self._seen(), self._infos(self._names)
        raise InputError(f"litsim: nobody is taken over at {STARTS} starts; expected traffic around the ego")

    def step(self, actions: Mapping[str, Array]) -> Results:
        """Drive :attr:`agents` by `actions` (3,) each for a step of 0.1 s.

        Returns:
            observations, rewards, terminated, truncated, and information (the vehicle's id), by name: of the agents
            driven, and of those that are new.
        """
        driven = [actions[self._names[agent]] for agent in self._episodes.driven.tolist()]
        outcome = self._episodes.step(np.array(driven, np.float64).reshape(-1, len(ACTIONS)))
        before, going_on = self._names, outcome.agents[outcome.driven_on].tolist()
        names = [before[agent] for agent in outcome.agents.tolist()]
        self._names = {agent: before[agent] for agent in going_on}
        self._go_on()
        reward = rewards(self._progress, outcome.following, outcome.penalty).tolist()
        last = dict(zip(names, outcome.following.astype(np.float32), strict=True))
        terminated = dict.fromkeys(self.agents, False) | dict(zip(names, outcome.terminated.tolist(), strict=True))
        truncated = {name: name not in self.agents and not is_over for name, is_over in terminated.items()}
        return (
            last | self._seen(),
            dict.fromkeys(self.agents, 0.0) | dict(zip(names, reward, strict=True)),
            terminated,
            truncated,
            self._infos(before) | self._infos(self._names),  # one taken over again has a new name
        )

    def _go_on(self) -> None:
        """Pass over steps in which nobody is driven, and name the agents that are new."""
        while self._episodes.running[0] and not len(self._episodes.driven):
            self._episodes.step(np.empty((0, len(ACTIONS))))
        driven = self._episodes.driven.tolist()
        if len(set(driven) - self._names.keys()) > len(self._unused):
            driven = []
        self._names = {agent: self._names.get(agent) or self._unused.pop() for agent in driven}
        self.agents = list(self._names.values())

    def _seen(self) -> dict[str, Array]:
        """Returns the observations of :attr:`agents`, by name."""
        return dict(zip(self.agents, self._episodes.seen.astype(np.float32), strict=False))

    def _infos(self, names: Mapping[int, str]) -> dict[str, dict[str, Any]]:
        """Returns the information about agents, whose `names` are by id."""
        recorded = self._episodes.batch.log.recorded_ids
        return {name: {"agent": int(recorded[agent])} for agent, name in names.items()}
