"""The ego that keeps its lane and follows its leader by the Intelligent Driver Model; it deviates from its log."""

from __future__ import annotations

import numpy as np

from litsim_policy.motion.car_following import IdmConfig, along_path, idm_acceleration
from litsim_policy.motion.reference_path import ReferencePath, lane_path, pursuit_yaw_rate
from litsim_policy.motion.stop_lines import StopLines
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.scenario.scenario import Scenario

CAREFUL = IdmConfig(desired_speed=10.0, headway=1.5, standstill_gap=1.0, acceleration=1.0, deceleration=3.0)
"""Parameters of nuPlan's IDM planner: slower and with more headway than dense motorway traffic, so it deviates."""


class IdmEgo:
    """Drives along the centre line of the lane that it is on when its history is over, and stops at red."""

    def __init__(self, scenario: Scenario, config: IdmConfig = CAREFUL) -> None:
        self._scenario = scenario
        self._config = config
        self._path: ReferencePath | None = None
        self._stop_lines = StopLines(scenario.signals)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.registry.Ego`."""
        row = table.row(self._scenario.ego_id)
        if row < 0 or table.step < self._scenario.history_steps:
            return EgoCommand(table.step)
        x, y, yaw, speed = (float(getattr(table, f)[row]) for f in ("x", "y", "yaw", "speed"))
        if self._path is None:
            self._path = lane_path(self._scenario.lane_map, x, y, yaw)
        view = along_path(self._path, table, row)
        leads = view.ahead & view.in_path
        own = slice(row, row + 1)
        line = self._stop_lines.gaps(table.step, self._path.batch, view.s[own], table.length[own], table.speed[own])
        stops = line[np.isfinite(line)]  # a leader that stands
        acceleration = idm_acceleration(
            self._config,
            speed,
            self._config.desired_speed,
            np.append(view.gap[leads], stops),
            np.append(view.speed[leads], np.zeros(len(stops))),
        )
        return EgoCommand(table.step, float(acceleration), pursuit_yaw_rate(self._path, x, y, yaw, speed))
