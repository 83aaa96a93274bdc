"""The policy `keep_gap`: agents near the ego keep a time gap to the vehicle ahead of them on their paths."""

from __future__ import annotations

import numpy as np

from litsim_policy.driving.policy import Policy
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.quantities import Acceleration, Duration, Positive, configuration
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.setting import Setting


@configuration
class KeepGapConfig:
    """Parameters, set as in ``--set policy.keep_gap.time_gap=2.0``: time gap to keep, and limit on accelerations."""

    time_gap: Positive[Duration] = 1.5
    acceleration_max: Positive[Acceleration] = 4.0


class KeepGap(Policy):
    """Drives every agent near the ego along its path, at a time gap to what is ahead."""

    defaults, prefix, by_region = KeepGapConfig(), "keep_gap.", True

    def __init__(self, scenario: Setting, config: KeepGapConfig) -> None:
        self._lane_map, self._config = scenario.lane_map, config

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        if not takeovers.takeovers:
            return ControlTable.empty(table.step)
        agents = PathFollowers.of_takeovers(self._lane_map, table, takeovers.takeovers)
        view, most = agents.view, self._config.acceleration_max
        gap = np.where(view.in_path & view.ahead, view.gap, 100.0).min(axis=1, initial=100.0)  # [m] to the next ahead
        acceleration = np.clip(0.2 * (gap - 2.0 - self._config.time_gap * agents.speed), -most, most)
        return ControlTable.of_policy(table, agents.rows, acceleration, agents.path_yaw_rate)
