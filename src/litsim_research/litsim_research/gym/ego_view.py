"""How a network drives the ego: what it is shown at a step, and the command that its action is."""

from __future__ import annotations

import numpy as np

from litsim_policy.driving.features.traffic_observation import SIZE, TrafficObserver
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import route_path
from litsim_research.baselines.imitation_policy import BOUNDS
from litsim_sim.core.scene import AgentTable, EgoCommand, FloatArray
from litsim_sim.scenario.scenario import Scenario

OBSERVED = SIZE
"""Number of features of an observation, see :mod:`litsim_policy.driving.features.traffic_observation`."""
ACTIONS = len(BOUNDS)
"""Parts of an action: acceleration and yaw rate, as shares of BOUNDS [m/s2], [rad/s]."""


class EgoView:
    """The ego's view of a run; its way is that of its lane at the first step in view, along the roads of its log."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self._observer = scenario, TrafficObserver(scenario.lane_map)
        self._way: PathBatch | None = None

    def drives(self, table: AgentTable) -> bool:
        """Returns whether the ego is off its log at the step of `table`: after the history, and on the road."""
        return table.step >= self._scenario.history_steps and table.row(self._scenario.ego_id) >= 0

    def observe(self, table: AgentTable) -> FloatArray:
        """Returns the features (1, OBSERVED) of the ego, which is in `table`."""
        rows = table.rows(np.array([self._scenario.ego_id]))
        if self._way is None:
            pose = np.array([table.x[rows[0]], table.y[rows[0]], table.yaw[rows[0]]])
            path = route_path(self._scenario.log, self._scenario.lane_map, self._scenario.ego_id, pose)
            self._way = PathBatch.of([path.points])
        return self._observer.observe(PathFollowers(self._scenario.lane_map, table, rows, self._way))


def command_of(step: int, action: FloatArray) -> EgoCommand:
    """Returns the command of an action (ACTIONS,), which is clipped to [-1, 1]."""
    acceleration, yaw_rate = (np.clip(action, -1.0, 1.0) * BOUNDS).tolist()
    return EgoCommand(step, acceleration, yaw_rate)
