"""The baseline called `idm`: all agents in the region follow their leaders by the Intelligent Driver Model."""

from __future__ import annotations

from typing import Literal

import numpy as np

from litsim_data.traffic.drivers import calibrated
from litsim_policy.driving.policy import Policy
from litsim_policy.motion.car_following import IdmConfig, IdmValues, idm
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.stop_lines import StopLines
from litsim_sim.core.quantities import Acceleration, Positive, configuration
from litsim_sim.core.scene import AgentTable, ControlTable, FloatArray, IntArray
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.kernels.compiled import Bools2, Floats, Floats2, kernel
from litsim_sim.scenario.setting import Setting

PUBLISHED = IdmConfig()


@configuration
class IdmPolicyConfig:
    """Parameters of the drivers.

    Attributes:
        drivers: `medians` of all drivers that were calibrated on NGSIM; `drawn`, for each agent one of those drivers;
            or `published`, the values of sisl/ngsim_env.
        braking_max: limit on the model's braking.
    """

    drivers: Literal["medians", "drawn", "published"] = "medians"
    braking_max: Positive[Acceleration] = 8.0


class IdmPolicy(Policy):
    """Drives agents off their logs along their reference paths, behind others on them; stops at red.

    It neither changes lanes nor gives way to agents beside the path, and uses no forecasts.
    """

    defaults, prefix = IdmPolicyConfig(), "baseline."
    by_region = batched = True

    def __init__(self, scenario: Setting, config: IdmPolicyConfig) -> None:
        self._lane_map = scenario.lane_map
        self._config = config
        self._drivers = _drivers(config)
        self._agents = scenario.log.ids
        self._driver_of = _drawn(scenario.identities, len(self._drivers))
        self._stop_lines = StopLines(scenario.signals)

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        listed = takeovers.takeovers
        if not listed:
            return ControlTable.empty(table.step)
        agents = PathFollowers.of_takeovers(self._lane_map, table, listed)
        view, line = agents.view, self._stop_lines.of(agents)
        acceleration = _accelerations(
            agents.speed,
            self._drivers[self._driver_of[np.searchsorted(self._agents, table.id[agents.rows])]],
            np.column_stack([view.gap, line]),
            np.column_stack([view.speed, np.zeros(len(line))]),
            np.column_stack([agents.leaders.leads, np.isfinite(line)]),
            self._config.braking_max,
        )
        return ControlTable.of_policy(table, agents.rows, acceleration, agents.path_yaw_rate)


def _drawn(identities: IntArray, drivers: int) -> IntArray:
    """Returns rows (N,) of the agents' drivers among `drivers`, each drawn by the agent's seed and id (N, 2)."""
    if drivers == 1:
        return np.zeros(len(identities), np.int64)
    return np.array([np.random.default_rng(identity).integers(drivers) for identity in identities.tolist()], np.int64)


def _drivers(config: IdmPolicyConfig) -> FloatArray:
    """Returns parameters (k, 5) of the available drivers: v0 [m/s], T [s], s0 [m], a_max, b [m/s2]."""
    if config.drivers == "published":
        return np.array([[PUBLISHED.desired_speed, *PUBLISHED.values[:4]]])
    everybody = np.concatenate([rows for _, rows in sorted(calibrated().drivers.items())])
    return everybody if config.drivers == "drawn" else np.median(everybody, axis=0)[None]


@kernel
def _accelerations(
    speed: Floats, driver: Floats2, gap: Floats2, along: Floats2, leads: Bools2, braking_max: float
) -> Floats:
    """Returns accelerations (m,) [m/s2] of vehicles, each with a driver of its own.

    Args:
        speed: (m,) [m/s].
        driver: (m, 5) as in :func:`_drivers`.
        gap, along: (m, n) to all agents and their speed along the path [m], [m/s]; a stop line counts as standing.
        leads: (m, n) whether an agent is on the path ahead.
        braking_max: as in :class:`IdmPolicyConfig`.
    """
    acceleration = np.empty(len(speed))
    for i in range(len(speed)):
        desired, headway, standstill, fastest, comfortable = driver[i]
        model = IdmValues(headway, standstill, fastest, comfortable, braking_max)
        acceleration[i] = idm(speed[i], desired, gap[i], along[i], leads[i], model)
    return acceleration
