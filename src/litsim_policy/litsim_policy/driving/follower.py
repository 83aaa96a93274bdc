"""Car following as people do it: the Intelligent Driver Model, with the headway that the driver keeps."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from litsim_policy.driving.drawn_drivers import DrawnDrivers, SpreadConfig
from litsim_policy.driving.handback import SPEED_GAIN
from litsim_policy.motion.car_following import IdmValues, Leaders, following
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.kept_headways import TIME_GAP_MAX, KeptHeadways
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Number, Positive, configuration
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, kernel, tuple_of
from litsim_sim.scenario.setting import Setting

SIGHT = 60.0  # [m] gap beyond which agents do not go along with the one ahead
FASTER = 1.2  # most by which agents drive faster than their logs, to go along with the one ahead: a factor


@configuration
class FollowerConfig:
    """How people follow, fitted to recorded drivers by ``litsim_research train followers``.

    The driver's own headway is estimated from what the driver did while on the log.

    Attributes:
        headway: of a driver of whom nothing is known yet.
        looks: number of looks at a driver, one every half second, after which own and general headway count alike.
        standstill_gap: behind a standing leader.
        acceleration: the maximum.
        deceleration: comfortable braking.
        braking_max: limit on the braking of the model.
        spread: between drivers, if they are drawn.
    """

    headway: NonNegative[Duration] = 0.93
    looks: Positive[Number] = 6.8
    standstill_gap: NonNegative[Length] = 2.6
    acceleration: Positive[Acceleration] = 0.78
    deceleration: Positive[Acceleration] = 1.35
    braking_max: Positive[Acceleration] = 3.1
    spread: SpreadConfig = SpreadConfig()

    @cached_property
    def values(self) -> IdmValues:
        """The parameters of the model, as kernels take them."""
        return tuple_of(IdmValues, self)


class Follower:
    """The car following of all agents of a scenario, each with the headway of its own driver."""

    def __init__(self, scenario: Setting, config: FollowerConfig, *, drawn: bool = False) -> None:
        """Make the drivers of `scenario`, each the median one of its headway unless they are `drawn`."""
        self._model = config.values
        self._drawn = DrawnDrivers(scenario, config.spread) if drawn else None
        self._headways = KeptHeadways(scenario.log, self._model, config.looks)

    def along(self, agents: PathFollowers, wanted: FloatArray, log_speed: FloatArray) -> FloatArray:
        """Returns `wanted` (m,) [m/s2], or more where the agents ahead are faster than the agents' logs.

        The speed of a log behind others, `log_speed` (m,) [m/s], is not all that its driver wants: people go along.
        """
        speed = np.minimum(_next_speed(agents.leaders), FASTER * log_speed)
        return np.where(speed > log_speed, np.maximum(wanted, SPEED_GAIN * (speed - agents.speed)), wanted)

    def limited(self, agents: PathFollowers, wanted: FloatArray, since: IntArray) -> FloatArray:
        """Returns `wanted` (m,) [m/s2], or less where the agents follow others on their paths.

        They have been off their logs `since` (m,) these steps.
        """
        who = agents.table.id[agents.rows]
        headway = self._headways.of(who, since)
        if self._drawn is None:
            return np.minimum(wanted, _behind(agents.speed, headway, agents.leaders, self._model))
        factor, noise = self._drawn.of(who, agents.table.step)
        return np.minimum(wanted, _behind(agents.speed, headway * factor, agents.leaders, self._model) + noise)


@kernel
def _next_speed(leaders: Leaders) -> Floats:
    """Speeds (m,) [m/s] of the next of the leaders of m vehicles; 0 for none."""
    speed = np.zeros(len(leaders.first))
    for i in range(len(speed)):
        least = SIGHT
        for j in range(leaders.gap.shape[1]):
            if leaders.leads[i, j] and 0.0 < leaders.gap[i, j] < least:
                least, speed[i] = leaders.gap[i, j], leaders.speed[i, j]
    return speed


@kernel
def _behind(speed: Floats, headway: Floats, leaders: Leaders, model: IdmValues) -> Floats:
    """Accelerations (m,) [m/s2] behind the most demanding of the leaders, infinite for none.

    `speed` [m/s] and `headway` [s] are (m,). Leaders so far ahead that nobody follows them only count where they have
    to be braked for.
    """
    behind = np.full(len(speed), np.inf)
    for i in range(len(speed)):
        own = IdmValues(headway[i], model.standstill_gap, model.acceleration, model.deceleration, model.braking_max)
        for j in range(leaders.gap.shape[1]):
            if leaders.leads[i, j] and leaders.gap[i, j] > 0.0:
                lead, change = max(leaders.speed[i, j], 0.0), leaders.acceleration[leaders.first[i] + j]
                most = following(speed[i], leaders.gap[i, j], lead, change, own)
                if most < 0.0 or leaders.gap[i, j] < TIME_GAP_MAX * speed[i]:
                    behind[i] = min(behind[i], most)
    return behind
