"""Conversion between :class:`Forecast` and ``litsim_msgs/JointForecast``."""

from __future__ import annotations

import numpy as np
from litsim_msgs.msg import JointForecast

from litsim_predictor.forecast import Forecast
from litsim_sim.ros.messages import from_array, header, to_array


def forecast_to_message(forecast: Forecast, run_id: str) -> JointForecast:
    """The message ``JointForecast`` that carries `forecast` in the run named `run_id`."""
    return JointForecast(
        header=header(forecast.step),
        run_id=run_id,
        step=forecast.step,
        dt=forecast.dt,
        horizon=forecast.dt * forecast.mean.shape[1],
        id=to_array(forecast.id),
        mean=to_array(forecast.mean),
        yaw=to_array(forecast.yaw),
        covariance=to_array(forecast.covariance),
        maneuver_probability=to_array(forecast.maneuver_probability),
        valid=forecast.valid.tolist(),
    )


def forecast_from_message(message: JointForecast) -> Forecast:
    """The forecast that the message ``JointForecast`` carries."""
    count, steps = len(message.id), round(message.horizon / message.dt)
    return Forecast(
        step=message.step,
        dt=message.dt,
        id=from_array(message.id, np.int64),
        mean=from_array(message.mean, np.float64).reshape(count, steps, 2),
        yaw=from_array(message.yaw, np.float32).reshape(count, steps),
        covariance=from_array(message.covariance, np.float32).reshape(count, steps, 3),
        maneuver_probability=from_array(message.maneuver_probability, np.float32).reshape(count, -1 if count else 0),
        valid=np.array(message.valid, np.bool_),
    )
