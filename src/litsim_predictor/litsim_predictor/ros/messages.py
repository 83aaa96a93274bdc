"""Conversion between :class:`Forecast` and ``litsim_msgs/JointForecast``."""

from __future__ import annotations

import numpy as np
from litsim_msgs.msg import JointForecast

from litsim_predictor.forecast import DT_MIN_S, Float32Array, Forecast, Modes
from litsim_sim.core import topic_names
from litsim_sim.core.checks import check_columns
from litsim_sim.core.scene import IntArray
from litsim_sim.ros.messages import header, refused, to_array

HORIZON_MAX_S = 3600.0  # [s] beyond which a forecast is none
ROUNDING = 1e-3
"""By which sums of probabilities, and correlations, may exceed 1."""


def forecast_to_message(forecast: Forecast, run_id: str) -> JointForecast:
    """Returns the message ``JointForecast`` that carries `forecast` in the run named `run_id`."""
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
        mode_row=to_array(forecast.modes.row.astype(np.uint32)),
        mode_probability=to_array(forecast.modes.probability),
        mode_mean=to_array(forecast.modes.mean),
        mode_yaw=to_array(forecast.modes.yaw),
        mode_covariance=to_array(forecast.modes.covariance),
    )


def forecast_from_message(message: JointForecast) -> Forecast:
    """Returns the forecast that the message ``JointForecast`` carries."""
    count, steps = len(message.id), round(message.horizon / message.dt)
    more = len(message.mode_row)
    return Forecast(
        step=message.step,
        dt=message.dt,
        id=np.array(message.id, np.int64),
        mean=np.array(message.mean, np.float64).reshape(count, steps, 2),
        yaw=np.array(message.yaw, np.float32).reshape(count, steps),
        covariance=np.array(message.covariance, np.float32).reshape(count, steps, 3),
        maneuver_probability=np.array(message.maneuver_probability, np.float32).reshape(count, -1 if count else 0),
        valid=np.array(message.valid, np.bool_),
        modes=Modes(
            row=np.array(message.mode_row, np.uint32).astype(np.int64),
            probability=np.array(message.mode_probability, np.float32),
            mean=np.array(message.mode_mean, np.float64).reshape(more, steps, 2),
            yaw=np.array(message.mode_yaw, np.float32).reshape(more, steps),
            covariance=np.array(message.mode_covariance, np.float32).reshape(more, steps, 3),
        ),
    )


def received_forecast(message: JointForecast) -> Forecast:
    """Returns the forecast of a ``JointForecast`` that has come to a stage.

    Raises:
        InputError: its arrays are not n agents by T steps, its ids do not ascend, or valid entries are not finite, are
            no shares of 1, or no standard deviations and correlations.
    """
    with refused(topic_names.FORECASTS):
        if not (message.dt >= DT_MIN_S and 0.0 <= message.horizon <= HORIZON_MAX_S):
            raise ValueError(
                f"dt is {message.dt} s and horizon {message.horizon} s, expected a dt of at least {DT_MIN_S:g} s and a "
                f"horizon of at most {HORIZON_MAX_S:g} s"
            )
        count, steps = len(message.id), round(message.horizon / message.dt)
        for name, size in (("mean", 2), ("yaw", 1), ("covariance", 3)):
            if len(getattr(message, name)) != count * steps * size:
                raise ValueError(
                    f"{name} has {len(getattr(message, name))} values, expected {count * steps * size}: of {count} "
                    f"agents at {steps} steps {size} each"
                )
        if len(message.maneuver_probability) % max(1, count):
            raise ValueError(
                f"maneuver_probability has {len(message.maneuver_probability)} values, expected equally many of each "
                f"of {count} agents"
            )
        if len(message.valid) != count:
            raise ValueError(f"valid has {len(message.valid)} values, expected {count}, as many as id")
        _check_modes(message, count, steps)
        forecast = forecast_from_message(message)
        check_columns({"id": forecast.id})
        names = ("id", "mean", "yaw", "covariance", "maneuver_probability")
        used = {name: getattr(forecast, name)[forecast.valid] for name in names}
        check_columns(used)
        _check_shares(used["maneuver_probability"], used["id"])
        _check_spread("covariance", used["covariance"], used["id"])
        _check_spread("mode_covariance", forecast.modes.covariance, forecast.id[forecast.modes.row])
    return forecast


def _check_shares(probability: Float32Array, ids: IntArray) -> None:
    """Refuse probabilities (n, K) of the manoeuvres of the agents `ids` (n,) that are negative or do not add up to 1.

    Raises:
        ValueError: they are refused; the text names the agent.
    """
    wrong = (probability < 0.0).any(axis=1) | (np.abs(probability.sum(axis=1) - 1.0) > ROUNDING)
    if probability.shape[1] and wrong.any():
        k = int(wrong.argmax())
        raise ValueError(
            f"maneuver_probability of agent {ids[k]} is {probability[k].tolist()}, expected shares that add up to 1"
        )


def _check_spread(name: str, covariance: Float32Array, ids: IntArray) -> None:
    """Refuse `covariance` (n, T, 3) of the agents `ids` (n,) that is of no Gaussian, such as variances and covariances.

    Raises:
        ValueError: it is refused; the text gives it `name`, and names the agent.
    """
    wrong = (covariance[..., :2] < 0.0).any(axis=-1) | (np.abs(covariance[..., 2]) > 1.0 + ROUNDING)
    if wrong.any():
        k, t = np.argwhere(wrong)[0]
        raise ValueError(
            f"{name} of agent {ids[k]} has {', '.join(map(str, covariance[k, t].tolist()))}, expected two standard "
            "deviations of at least 0 m and a correlation from -1 to 1"
        )


def _check_modes(message: JointForecast, count: int, steps: int) -> None:
    """Refuse further manoeuvres of unknown agents, out of order, or with values that are not finite.

    Raises:
        ValueError: they are refused; the text says what was expected.
    """
    row, probability = np.asarray(message.mode_row, np.int64), np.asarray(message.mode_probability, np.float64)
    for name, size in (("probability", 1), ("mean", 2 * steps), ("yaw", steps), ("covariance", 3 * steps)):
        values = np.asarray(getattr(message, f"mode_{name}"), np.float64)
        if len(values) != len(row) * size:
            raise ValueError(f"mode_{name} has {len(values)} values, expected {len(row) * size}: {size} of each mode")
        if not np.isfinite(values).all():
            raise ValueError(f"mode_{name} is not finite, expected finite numbers")
    if (np.diff(row) < 0).any() or (row >= count).any():
        raise ValueError(f"mode_row is {row.tolist()}, expected positions of the {count} agents, ascending")
    total = np.bincount(row, probability, count) if len(row) else np.zeros(count)
    if (probability <= 0.0).any() or (total > 1.0 + ROUNDING).any():
        raise ValueError(
            "mode_probability has values that are no shares of 1, expected more than 0 and in all at most 1"
        )
