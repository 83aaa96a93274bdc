"""A forecast for tests."""

import numpy as np

from litsim_predictor.forecast import Forecast
from litsim_sim.core.scene import AgentTable


def straight_on(table: AgentTable, horizon: float = 5.0, dt: float = 0.2) -> Forecast:
    """Everybody goes on as it moves now, with a spread of 1 m by 0.5 m."""
    t = dt * np.arange(1, round(horizon / dt) + 1)
    heading = np.stack([np.cos(table.yaw), np.sin(table.yaw)], axis=-1)
    gone = (table.speed[:, None] * t)[..., None] * heading[:, None, :]
    mean = np.stack([table.x, table.y], axis=-1)[:, None, :] + gone
    return Forecast(
        step=table.step,
        dt=dt,
        id=table.id,
        mean=mean,
        yaw=np.repeat(table.yaw[:, None], len(t), axis=1).astype(np.float32),
        covariance=np.full((len(table), len(t), 3), [1.0, 0.5, 0.0], np.float32),
        maneuver_probability=np.empty((len(table), 0), np.float32),
        valid=np.ones(len(table), np.bool_),
    )
