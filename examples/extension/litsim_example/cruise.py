"""The ego `cruise`: holds a speed, straight on, until somebody is close ahead."""

from __future__ import annotations

import numpy as np

from litsim_policy.ego.ego import Ego
from litsim_sim.core.geometry import to_body
from litsim_sim.core.quantities import Length, Positive, Speed, configuration
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.scenario.scenario import Scenario


@configuration
class CruiseConfig:
    """Parameters, set as in ``--set ego.cruise.speed=8``: the speed to hold, and how near others may be ahead."""

    speed: Positive[Speed] = 10.0
    gap: Positive[Length] = 15.0


class Cruise(Ego):
    """Holds a speed, and brakes behind whoever is less than a gap ahead."""

    defaults, prefix = CruiseConfig(), "cruise."

    def __init__(self, scenario: Scenario, config: CruiseConfig) -> None:
        self._ego, self._config = scenario.ego_id, config

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        row = table.row(self._ego)
        if row < 0:  # it has left the road
            return EgoCommand(table.step)
        ahead, left = to_body(table.x - table.x[row], table.y - table.y[row], table.yaw[row])
        near = (ahead > 0.0) & (ahead < self._config.gap) & (abs(left) < 1.5)
        wanted = 0.0 if near.any() else self._config.speed
        return EgoCommand(table.step, acceleration=float(np.clip(wanted - table.speed[row], -4.0, 1.5)))
