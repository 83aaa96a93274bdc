"""Forecasts to messages and back through CDR."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from litsim_msgs.msg import JointForecast
from rclpy.serialization import deserialize_message, serialize_message

from litsim_predictor.forecast import Forecast, Modes
from litsim_predictor.ros.messages import forecast_from_message, forecast_to_message, received_forecast
from litsim_sim.core.errors import InputError
from litsim_sim.ros.messages import header
from wire import damaged, taken


def through_cdr(forecast: Forecast) -> Forecast:
    data = serialize_message(forecast_to_message(forecast, "run-1"))
    return forecast_from_message(deserialize_message(data, JointForecast))


def assert_same(one: Forecast, other: Forecast, but: tuple[str, ...] = ()) -> None:
    names = [f.name for f in fields(Forecast) if f.name not in ("modes", *but)]
    pairs = [(name, getattr(one, name), getattr(other, name)) for name in names]
    pairs += [(f.name, getattr(one.modes, f.name), getattr(other.modes, f.name)) for f in fields(Modes)]
    for name, first, second in pairs:
        a, b = np.asarray(first), np.asarray(second)
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), name


def made(count: int, steps: int, maneuvers: int, dt: float = 0.2, seed: int = 0) -> Forecast:
    rng = np.random.default_rng(seed)
    shares = rng.random((count, maneuvers))
    return Forecast(
        step=41,
        dt=dt,
        id=np.sort(rng.choice(10**12, count, replace=False)).astype(np.int64),
        mean=rng.normal(0, 100, (count, steps, 2)),
        yaw=rng.normal(0, 2, (count, steps)).astype(np.float32),
        covariance=rng.random((count, steps, 3)).astype(np.float32),
        maneuver_probability=(shares / shares.sum(axis=1, keepdims=True)).astype(np.float32),
        valid=rng.random(count) < 0.5,
        modes=made_modes(count, steps, rng),
    )


def one_mode_each(count: int, steps: int) -> Modes:
    """One further manoeuvre of each agent."""
    shape = (count, steps)
    zeros = np.zeros(shape, np.float32)
    return Modes(
        np.arange(count),
        np.full(count, 0.2, np.float32),
        np.zeros((*shape, 2)),
        zeros,
        np.zeros((*shape, 3), np.float32),
    )


def made_modes(count: int, steps: int, rng: np.random.Generator) -> Modes:
    """Up to two further manoeuvres of each of `count` agents."""
    row = np.repeat(np.arange(count), rng.integers(0, 3, count)) if count else np.empty(0, np.int64)
    many = len(row)
    return Modes(
        row=row,
        probability=rng.uniform(0.05, 0.3, many).astype(np.float32),
        mean=rng.normal(0, 100, (many, steps, 2)),
        yaw=rng.normal(0, 2, (many, steps)).astype(np.float32),
        covariance=rng.random((many, steps, 3)).astype(np.float32),
    )


@given(
    count=st.integers(1, 8),
    steps=st.integers(1, 60),
    maneuvers=st.integers(0, 9),
    dt=st.sampled_from([0.1, 0.2, 0.3, 0.5, 1.0]),
    seed=st.integers(0, 1000),
)
def test_forecasts_come_back_bit_for_bit(count: int, steps: int, maneuvers: int, dt: float, seed: int) -> None:
    forecast = made(count, steps, maneuvers, dt, seed)
    assert_same(through_cdr(forecast), forecast)


def test_the_number_of_steps_survives_the_rounding_of_the_horizon() -> None:
    rng = np.random.default_rng(7)
    for dt, steps in zip(rng.uniform(0.01, 1.0, 500).tolist(), rng.integers(1, 100, 500).tolist(), strict=True):
        assert forecast_from_message(forecast_to_message(made(1, steps, 0, dt), "run-1")).mean.shape == (1, steps, 2)


@pytest.mark.parametrize("steps", [1, 25, 50])
def test_a_forecast_of_nobody_keeps_its_horizon(steps: int) -> None:
    assert_same(through_cdr(made(0, steps, 0)), made(0, steps, 0))
    back = through_cdr(made(0, steps, 6))  # without agents, nobody knows the number of manoeuvres
    assert_same(back, made(0, steps, 6), but=("maneuver_probability",))
    assert len(back.maneuver_probability) == 0


def test_the_message_says_what_it_is_about() -> None:
    message = forecast_to_message(made(3, 25, 2), "run-1")
    assert (message.run_id, message.step, message.dt, message.header) == ("run-1", 41, 0.2, header(41))
    assert message.horizon == pytest.approx(5.0)
    counts = [len(getattr(message, f)) for f in ("id", "mean", "yaw", "covariance", "maneuver_probability", "valid")]
    assert counts == [3, 150, 75, 225, 6, 3]


def test_arrays_are_row_major() -> None:
    forecast = made(2, 3, 2)
    message = forecast_to_message(forecast, "run-1")
    assert message.mean[(1 * 3 + 2) * 2 + 1] == forecast.mean[1, 2, 1]
    assert message.covariance[(1 * 3 + 2) * 3 + 2] == forecast.covariance[1, 2, 2]
    assert message.maneuver_probability[1 * 2 + 1] == forecast.maneuver_probability[1, 1]


def test_a_forecast_from_a_message_can_be_changed() -> None:
    forecast = through_cdr(made(2, 3, 2))
    forecast.mean[0, 0, 0] = 7.0
    forecast.valid[0] = True
    assert forecast.mean[0, 0, 0] == 7.0


GOOD = forecast_to_message(made(3, 4, 2), "run-1")


@settings(max_examples=300)
@given(damaged(GOOD))
def test_a_forecast_that_came_is_sound_or_refused(message: JointForecast) -> None:
    forecast = taken(received_forecast, message, InputError, "/litsim/forecasts: ")
    if forecast is None:
        return
    count, steps = forecast.yaw.shape
    assert forecast.mean.shape == (count, steps, 2) and forecast.covariance.shape == (count, steps, 3)
    assert len(forecast.id) == len(forecast.valid) == len(forecast.maneuver_probability) == count
    assert (np.diff(forecast.id) > 0).all()
    for values in (forecast.mean, forecast.yaw, forecast.covariance):
        assert np.isfinite(values[forecast.valid]).all()
    if forecast.maneuver_probability.shape[1]:
        assert np.allclose(forecast.maneuver_probability[forecast.valid].sum(axis=1), 1.0, atol=2e-3)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("dt", 0.0, "dt is 0.0 s and horizon 0.8 s, expected a dt of at least 0.001 s and a horizon of at most 3600 s"),
        ("horizon", 1.0, "mean has 24 values, expected 30: of 3 agents at 5 steps 2 each"),
        ("yaw", [0.0], "yaw has 1 values, expected 12: of 3 agents at 4 steps 1 each"),
        ("valid", [True], "valid has 1 values, expected 3, as many as id"),
        ("maneuver_probability", [0.5] * 4, "maneuver_probability has 4 values, expected equally many of each of 3"),
        ("maneuver_probability", [0.5] * 5 + [float("nan")], "maneuver_probability of agent "),
        (
            "maneuver_probability",
            [0.5] * 4 + [1.5, -0.5],
            "maneuver_probability of agent 729496560983 is [1.5, -0.5]",
        ),
        ("maneuver_probability", [0.5] * 4 + [0.5, 0.4], "maneuver_probability of agent 729496560983 is [0.5, 0.4"),
        ("covariance", [1.0, -1.0, 0.0] * 12, "covariance of agent 543624991465 has 1.0, -1.0, 0.0, expected two"),
        ("covariance", [1.0, 2.0, 1.5] * 12, "covariance of agent 543624991465 has 1.0, 2.0, 1.5, expected two"),
        (
            "mode_covariance",
            [1.0, 2.0, 1.5] * 12,
            "mode_covariance of agent 543624991465 has 1.0, 2.0, 1.5, ",
        ),
        ("mode_row", [0, 1], "mode_probability has 3 values, expected 2: 1 of each mode"),
        ("mode_row", [2, 1, 0], "mode_row is [2, 1, 0], expected positions of the 3 agents, ascending"),
        ("mode_row", [0, 1, 3], "mode_row is [0, 1, 3], expected positions of the 3 agents, ascending"),
        ("mode_probability", [0.5, 0.0, 0.5], "mode_probability has values that are no shares of 1"),
        ("mode_yaw", [0.0], "mode_yaw has 1 values, expected 12: 4 of each mode"),
        ("mode_mean", [float("nan")] * 24, "mode_mean is not finite, expected finite numbers"),
        ("id", [1, 1, 2], "id 1 follows 1, expected ids that ascend"),
        ("mean", [float("inf")] * 24, "mean of agent "),
    ],
)
def test_what_is_wrong_with_a_forecast_is_named(field: str, value: object, expected: str) -> None:
    good = replace(made(3, 4, 2), valid=np.ones(3, np.bool_), modes=one_mode_each(3, 4))
    message = forecast_to_message(good, "run-1")
    setattr(message, field, value)
    with pytest.raises(InputError) as raised:
        received_forecast(message)
    assert str(raised.value).startswith(f"/litsim/forecasts: {expected}")


def test_forecasts_of_some_and_of_nobody_come_through() -> None:
    assert_same(received_forecast(GOOD), forecast_from_message(GOOD))
    nobody = Forecast.empty(3)
    assert_same(received_forecast(forecast_to_message(nobody, "run-1")), nobody)
