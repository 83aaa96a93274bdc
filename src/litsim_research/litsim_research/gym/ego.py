"""The environment `litsim/Ego-v0`: drive the ego among agents that react to it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from litsim_research.gym.common import Array, Scenarios, action_space, loaded, observation_space, rewards
from litsim_research.gym.ego_view import ACTIONS, OBSERVED, EgoView, command_of
from litsim_research.policies.draw import with_ego
from litsim_research.policies.reward import Penalties, PenaltyConfig, penalties
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.core.stages import EndReason
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation


class EgoEnvironment(gymnasium.Env[Array, Array]):
    """The ego, from the end of the history on, in a run of :class:`litsim_sim.simulation.Simulation`.

    The observation is that of :mod:`litsim_policy.driving.features.traffic_observation`, of the way along the ego's
    lane. The action is acceleration and yaw rate, each in [-1, 1] of 4 m/s2 and 0.15 rad/s. Other agents are driven as
    in any run with `policy`. The reward of a step is `progress` times the distance driven [m], less the penalties. An
    episode is terminated when the ego touches an agent that it does not touch in the log, or leaves the road, and
    truncated when it leaves the net or the scenario is over.

    Args:
        scenario: what an episode draws its scenario from, and its ego among those that the scenario permits.
        policy: of the background.
        parameters: of the stages, by stage and name.
        progress: reward for each metre driven.
        penalty: weights of the penalties.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as in the base class

    def __init__(
        self,
        scenario: Scenarios = "demo",
        *,
        policy: str = "litsim",
        parameters: Parameters | None = None,
        progress: float = 0.1,
        penalty: PenaltyConfig | None = None,
    ) -> None:
        self._scenarios, self._policy, self._parameters = loaded(scenario), policy, parameters
        self._progress, self._penalty = progress, penalty or PenaltyConfig()
        self.observation_space, self.action_space = observation_space(OBSERVED), action_space(ACTIONS)
        self._scenario: Scenario
        self._simulation: Simulation

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin a new episode, where the history ends; `options` are not used."""
        super().reset(seed=seed, options=options)
        drawn = with_ego(self._scenarios[int(self.np_random.integers(len(self._scenarios)))], self.np_random)
        self._scenario = drawn.around(None, None, end_after_contact_s=0.0)
        self._view, self._perception = EgoView(self._scenario), Perception(self._scenario)
        self._simulation = Simulation(self._scenario, None, self._policy, self._parameters)
        table = self._simulation.table
        while not self._view.drives(table):
            table = self._simulation.step(EgoCommand(table.step))
        self._seen = self._view.observe(self._perception.of(table))
        return self._seen[0].astype(np.float32), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive the ego by `action` (2,) for a step of 0.1 s.

        Returns:
            observation, reward, whether the episode is terminated, or truncated, and information: the ego's id, the
            step, and the name of the scenario.
        """
        before = self._simulation.table
        after = self._simulation.step(command_of(before.step, np.asarray(action, np.float64)))
        end, penalty, off_road = self._simulation.world.ended, np.zeros(1), False
        if after.row(self._scenario.ego_id) >= 0:
            self._seen = self._view.observe(self._perception.of(after))
            terms = self._terms(before, after)
            penalty, off_road = terms.total(self._penalty), bool(terms.off_road[0])
        terminated = off_road or (end is not None and end.reason == EndReason.CONTACT)
        truncated = not terminated and (end is not None or after.step == self._scenario.total_steps)
        reward = float(rewards(self._progress, self._seen, penalty)[0])
        return self._seen[0].astype(np.float32), reward, terminated, truncated, self._info()

    def _terms(self, before: AgentTable, after: AgentTable) -> Penalties:
        """Returns the ego's penalties for the step from `before` to `after`."""
        ego, lane_map = self._scenario.ego_ids, self._scenario.lane_map
        return penalties(before, after, ego, lane_map, np.zeros(1, np.bool_), np.zeros(1))

    def _info(self) -> dict[str, Any]:
        scenario = self._scenario
        return {"agent": scenario.ego_id, "step": self._simulation.table.step, "scenario": scenario.name}
