"""The ego `idm`, which keeps its lane and follows its leader by the Intelligent Driver Model, off its log."""

from __future__ import annotations

from litsim_policy.ego.following import Following, FollowingEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_policy.motion.reference_path import lane_path
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.scenario.scenario import Scenario

CAREFUL = IdmConfig(desired_speed=10.0, headway=1.5, standstill_gap=1.0, acceleration=1.0, deceleration=3.0)
"""Parameters of nuPlan's IDM planner: slower and with more headway than dense motorway traffic, so it deviates."""


class IdmEgo(FollowingEgo):
    """Drives along the centre line of its lane at the end of the history, and stops at red."""

    defaults = CAREFUL

    def __init__(self, scenario: Scenario, config: IdmConfig = CAREFUL) -> None:
        super().__init__(scenario)
        self._config = config
        self._following: Following | None = None

    def following(self, table: AgentTable, row: int) -> Following | EgoCommand:
        """See :class:`.following.FollowingEgo`."""
        if row < 0 or table.step < self._scenario.history_steps:
            return EgoCommand(table.step)
        if self._following is None:
            place = (float(getattr(table, name)[row]) for name in ("x", "y", "yaw"))
            path, config = lane_path(self._scenario.lane_map, *place), self._config
            self._following = Following(path, model=config, desired_speed=config.desired_speed, stops=True)
        return self._following
