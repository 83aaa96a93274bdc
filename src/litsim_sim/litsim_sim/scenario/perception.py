"""What the ego is told of others: the agents of a step, with the errors that the changes of a scenario name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray
from litsim_sim.scenario.changes import Hide, Noise
from litsim_sim.scenario.scenario import Scenario


class Perception:
    """What the ego of a scenario is told; the same in every run of it."""

    def __init__(self, scenario: Scenario) -> None:
        changes = scenario.file.changes
        self._hidden = [change for change in changes if isinstance(change, Hide)]
        self._sigma = float(np.hypot.reduce([change.sigma_m for change in changes if isinstance(change, Noise)] or [0]))
        self._ego, self._steps, self._seed = scenario.ego_id, scenario.total_steps + 1, scenario.seed
        self._errors: dict[int, FloatArray] = {}

    def of(self, table: AgentTable) -> AgentTable:
        """Returns what the ego is told of the agents of a step; of itself the truth."""
        since = ((hide, table.step - round(hide.begin_s / STEP_S)) for hide in self._hidden)
        hidden = [hide.agent for hide, step in since if 0 <= step < round(hide.duration_s / STEP_S)]
        told = table.take(~np.isin(table.id, hidden)) if hidden else table
        if not self._sigma:
            return told
        error = np.stack([self._error(agent)[min(table.step, self._steps - 1)] for agent in told.id.tolist()])
        error[told.id == self._ego] = 0.0
        return replace(told, x=told.x + error[:, 0], y=told.y + error[:, 1])

    def _error(self, agent: int) -> FloatArray:
        """Returns the errors (steps, 2) of the position of an agent [m]."""
        if agent not in self._errors:
            random = np.random.default_rng([self._seed, agent])
            self._errors[agent] = random.normal(scale=self._sigma, size=(self._steps, 2))
        return self._errors[agent]
