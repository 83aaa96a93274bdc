"""Takeovers for baselines: agents are driven from when they come near the ego until they leave the net."""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.diverged import DivergedAgents, DivergedNow
from litsim_policy.conflict.opening import by_region
from litsim_predictor.forecast import Forecast
from litsim_sim.core.nearby import around
from litsim_sim.core.scene import AgentTable, BoolArray, IntArray
from litsim_sim.core.takeover import TakeoverReason, TakeoverTable
from litsim_sim.scenario.setting import Setting


class RegionManager:
    """Takes over all agents with their centres within the scenario's `roi_m` of the ego's, and hands none back.

    The paper's baselines know neither conflicts nor a return to logs. Each agent keeps its lane, along the route of its
    log; pedestrians and cyclists follow their logs. An agent that enters late, because its log began where the road was
    not free, is driven at once.

    Attributes:
        iterations, converged: (scenes,) as in :class:`.takeover.TakeoverManager`; always 0 and True.
    """

    def __init__(self, scenario: Setting, roi_m: float = 0.0) -> None:
        """Begin without takeovers; `roi_m` [m] replaces the scenario's unless it is 0; infinite, all are taken over."""
        self._scenario, self._roi_m = scenario, roi_m or scenario.roi_m
        self._diverged = DivergedAgents.empty()
        self.iterations: IntArray = np.zeros(len(scenario.ego_ids), np.int64)
        self.converged: BoolArray = np.ones(len(scenario.ego_ids), np.bool_)

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:  # noqa: ARG002 - of the interface
        """Returns the agents off their logs at this step; the forecast is ignored."""
        if table.step < self._scenario.history_steps:
            return TakeoverTable(table.step)
        agents = self._diverged.kept(table.rows(self._diverged.agent) >= 0)
        ego, late = table.mask(self._scenario.ego_ids), table.of_policy
        near = np.ones(len(table), np.bool_) if np.isinf(self._roi_m) else around(table, ego, self._roi_m)
        close = near & ~table.obstacle
        for row in np.flatnonzero((close | late) & ~ego & ~table.mask(agents.agent)).tolist():
            reason = TakeoverReason.BLOCKED_ENTRY if late[row] else TakeoverReason.REGION
            agents = agents.joined(by_region(self._scenario, table, row, reason))
        self._diverged = agents
        now = DivergedNow.at(self._scenario.log, agents, table, np.zeros(len(table), np.int64))
        return TakeoverTable(table.step, now.report(), iterations=0)
