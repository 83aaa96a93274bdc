"""The baseline called `rollout`: all agents in the region drive as a joint predictor expects them to.

So do learned models of traffic that are rolled out in closed loop, such as SMART (Wu et al. 2024): all agents are
forecast together, each drives the beginning of its most probable future, and at the next step they are forecast anew.
The network is a packaged one, trained to forecast and not in closed loop.
"""

from __future__ import annotations

import numpy as np

from litsim_policy.driving.policy import Policy
from litsim_policy.motion.reference_path import towards
from litsim_predictor.forecast import Wanted
from litsim_predictor.models import DEFAULT_MODEL, ModelName, make_predictor
from litsim_sim.core.geometry import to_body
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import STEP_S, AgentTable, ControlTable, FloatArray
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.setting import Setting

PREVIEW_S = 1.0  # [s] beginning of the forecast, which the controls reproduce
NEAR = 0.5  # [m] target nearer than this, towards which nobody turns


@configuration
class RolloutConfig:
    """Which network drives.

    Attributes:
        predictor: an installed predictor, or a file of weights or of a graph.
    """

    predictor: ModelName = DEFAULT_MODEL


class Rollout(Policy):
    """Drives all agents off their logs along their forecasts, without routes, rules or guards.

    An agent without a valid forecast keeps speed and heading.
    """

    defaults, prefix = RolloutConfig(), "rollout."
    by_region = batched = True

    def __init__(self, scenario: Setting, config: RolloutConfig) -> None:
        self._predictor = make_predictor(config.predictor, scenario, Wanted.ALL)

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        listed = takeovers.takeovers
        if not listed:
            self._predictor.observe(table)
            return ControlTable.empty(table.step)
        forecast = self._predictor.forecast(table)
        agents = np.array([takeover.agent for takeover in listed], np.int64)
        rows, expected = table.rows(agents), forecast.rows(agents)
        is_forecast = expected >= 0
        acceleration, yaw_rate = np.zeros(len(rows)), np.zeros(len(rows))
        if is_forecast.any():
            count = round(PREVIEW_S / forecast.dt)
            futures = forecast.mean[expected[is_forecast], :count]
            acceleration[is_forecast], yaw_rate[is_forecast] = along(table, rows[is_forecast], futures, forecast.dt)
        return ControlTable.of_policy(table, rows, acceleration, yaw_rate)


def along(table: AgentTable, rows: np.ndarray, futures: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Returns accelerations [m/s2] and yaw rates [rad/s] (m,) that lead agents along their futures.

    The acceleration fits the distances of the future positions by least squares; the yaw rate is that of the arc
    through the last one.

    Args:
        table: all agents.
        rows: (m,) of the agents in it.
        futures: (m, k, 2) their positions in frame map [m], `dt` [s] apart, the first `dt` from now.
        dt: time between two positions [s].
    """
    x, y, yaw, speed = table.x[rows], table.y[rows], table.yaw[rows], table.speed[rows]
    dx, dy = futures[:, :, 0] - x[:, None], futures[:, :, 1] - y[:, None]
    ahead, _ = to_body(dx, dy, yaw[:, None])
    way = np.copysign(np.hypot(dx, dy), ahead)
    time = dt * np.arange(1, futures.shape[1] + 1)
    gain = 0.5 * time**2
    acceleration = (way - speed[:, None] * time) @ gain / (gain @ gain)
    turns = way[:, -1] > NEAR
    yaw_rate = np.zeros(len(rows))
    yaw_rate[turns] = towards(futures[turns, -1], x[turns], y[turns], yaw[turns], speed[turns])
    return np.maximum(acceleration, -speed / STEP_S), yaw_rate
