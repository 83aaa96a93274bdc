"""Car following as people do it: the Intelligent Driver Model, with the time gap that the driver usually keeps."""

from __future__ import annotations

import numpy as np

from litsim_policy.motion.car_following import GAP_MIN, Leaders
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.usual_gaps import UsualGaps
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Number, Positive, configuration
from litsim_sim.core.scene import AgentTable, FloatArray
from litsim_sim.kernels.compiled import Floats, kernel
from litsim_sim.scenario.setting import Setting

TIME_GAP_MIN = 0.3  # [s] lower limit on time gaps


@configuration
class FollowerConfig:
    """How people follow; the time gap of a driver depends on what the driver did while on the log.

    Attributes:
        headway: time gap of a driver who usually keeps the typical one.
        own_share: change of the time gap with the usual one.
        typical: time gap that drivers usually keep.
        looks: number of looks, one every half second, after which own and typical time gap count alike.
        standstill_gap: behind a standing leader.
        acceleration: the maximum.
        deceleration: comfortable braking.
        braking_max: limit on the braking of the model.
    """

    headway: NonNegative[Duration] = 1.0
    own_share: Number = 0.5
    typical: NonNegative[Duration] = 1.35
    looks: Positive[Number] = 2.0
    standstill_gap: NonNegative[Length] = 2.0
    acceleration: Positive[Acceleration] = 1.5
    deceleration: Positive[Acceleration] = 1.7
    braking_max: Positive[Acceleration] = 4.0


class Follower:
    """The car following of all agents of a scenario, each with a time gap of its own."""

    def __init__(self, scenario: Setting, config: FollowerConfig) -> None:
        self._config, self._usual = config, UsualGaps(scenario.log)

    def observe(self, table: AgentTable) -> None:
        """Take into account how agents drive at the step of `table`; to be called once per step, in order."""
        self._usual.observe(table)

    def limited(self, agents: PathFollowers, wanted: FloatArray) -> FloatArray:
        """Returns `wanted` (m,) [m/s2], or less where the agents follow others on their paths."""
        config = self._config
        usual = self._usual.means(agents.table.id[agents.rows], config.typical, config.looks)
        headway = np.maximum(config.headway + config.own_share * (usual - config.typical), TIME_GAP_MIN)
        behind = _behind(
            agents.speed, headway, agents.leaders, config.standstill_gap, config.acceleration, config.deceleration
        )
        return np.minimum(wanted, np.maximum(behind, -config.braking_max))


@kernel
def _behind(
    speed: Floats, headway: Floats, leaders: Leaders, standstill: float, acceleration: float, deceleration: float
) -> Floats:
    """Accelerations (m,) [m/s2] behind the most demanding of the leaders; on a free road, the maximum.

    `speed` [m/s] and `headway` [s] are (m,).
    """
    behind = np.full(len(speed), acceleration)
    for i in range(len(speed)):
        for j in range(leaders.gap.shape[1]):
            if leaders.leads[i, j] and leaders.gap[i, j] > 0.0:
                closing = speed[i] - max(leaders.speed[i, j], 0.0)
                wanted = speed[i] * headway[i] + 0.5 * speed[i] * closing / np.sqrt(acceleration * deceleration)
                share = (standstill + max(wanted, 0.0)) / max(leaders.gap[i, j], GAP_MIN)
                behind[i] = min(behind[i], acceleration * (1.0 - share**2))
    return behind
