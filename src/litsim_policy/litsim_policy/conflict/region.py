"""Takeovers for baselines: agents are driven from when they come near the ego until they leave the net."""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.diverged import DivergedAgents, Residuals
from litsim_policy.motion.reference_path import logged_path, route_path
from litsim_predictor.forecast import Forecast
from litsim_sim.core.nearby import around
from litsim_sim.core.scene import AgentTable, BoolArray, IntArray
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverTable
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
        """Begin without takeovers; `roi_m` [m] replaces the scenario's unless it is 0."""
        self._scenario, self._roi_m = scenario, roi_m or scenario.roi_m
        self._ego_ids = scenario.ego_ids
        self._diverged = DivergedAgents.empty()
        self.iterations: IntArray = np.zeros(len(self._ego_ids), np.int64)
        self.converged: BoolArray = np.ones(len(self._ego_ids), np.bool_)

    def update(self, table: AgentTable, forecast: Forecast) -> TakeoverTable:  # noqa: ARG002 - of the interface
        """The agents off their logs at this step; the forecast is ignored."""
        if table.step < self._scenario.history_steps:
            return TakeoverTable(table.step)
        self._diverged = self._diverged.kept(table.rows(self._diverged.agent) >= 0)
        ego = table.mask(self._ego_ids)
        diverged = ego | table.mask(self._diverged.agent)
        late = table.of_policy
        close = around(table, ego, self._roi_m) & ~table.obstacle
        for row in np.flatnonzero((close | late) & ~diverged):
            self._open(table, int(row), TakeoverReason.BLOCKED_ENTRY if late[row] else TakeoverReason.REGION)
        rows = table.rows(self._diverged.agent)
        log = self._scenario.log
        on_time = np.zeros(len(rows), np.int64)
        residuals = Residuals.of(log, np.searchsorted(log.ids, self._diverged.agent), on_time, table, rows)
        return TakeoverTable(
            table.step, self._diverged.report(table.x[rows], table.y[rows], residuals.reported, on_time), iterations=0
        )

    def _open(self, table: AgentTable, row: int, reason: TakeoverReason) -> None:
        """Take over the agent in `row`, along its lane."""
        agent, pose = int(table.id[row]), np.array([table.x[row], table.y[row], table.yaw[row]])
        nothing = Conflict(agent, int(self._ego_ids[table.scene[row]]), 0.0, pose, 0.0)
        path = route_path(self._scenario.log, self._scenario.lane_map, agent, pose)
        logged = logged_path(self._scenario.log, self._scenario.lane_map, agent)
        opened = DivergedAgents.opened(nothing, table.step, reason, path, PathSource.LANE, logged)
        opened.in_conflict[:] = False
        self._diverged = self._diverged.joined(opened)
