"""Catching up with the log: bounds, sign, and convergence of the law alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.driving.handback import (
    ACCELERATION_MAX,
    DECELERATION_MAX,
    POSITION_GAIN,
    SPEED_EXCESS,
    SPEED_GAIN,
    catch_up,
)


def chase(lag: float, speed: float, log_speed: float, seconds: float, wave: float = 0.0) -> tuple[np.ndarray, ...]:
    """Lag [m], excess speed [m/s] and acceleration [m/s2] by step; the log's speed swings by `wave`."""
    lags, excesses, accelerations = [], [], []
    for k in range(round(10 * seconds)):
        log_acceleration = wave * np.cos(0.1 * k)
        acceleration = catch_up(lag, speed, log_speed, log_acceleration)
        faster, log_faster = max(0.0, speed + 0.1 * acceleration), log_speed + 0.1 * log_acceleration
        lag += 0.05 * (log_speed + log_faster - speed - faster)
        speed, log_speed = faster, log_faster
        lags.append(lag)
        excesses.append(speed - log_speed)
        accelerations.append(acceleration)
    return np.array(lags), np.array(excesses), np.array(accelerations)


def test_on_the_log_the_log_is_copied() -> None:
    assert catch_up(0.0, 10.0, 10.0, 0.0) == 0.0
    assert catch_up(0.0, 10.0, 10.0, -1.3) == pytest.approx(-1.3)


def test_who_stands_short_of_where_its_log_stops_closes_up() -> None:
    assert catch_up(0.0, 0.0, 1.4, -2.0) == pytest.approx(1.4 * SPEED_GAIN)
    assert catch_up(0.0, 9.0, 10.0, -2.0) == pytest.approx(-2.0 * 0.9**2 + SPEED_GAIN)


def test_behind_the_log_it_accelerates_and_ahead_of_it_it_brakes() -> None:
    assert catch_up(1.0, 10.0, 10.0, 0.0) == pytest.approx(POSITION_GAIN)
    assert catch_up(-1.0, 10.0, 10.0, 0.0) == pytest.approx(-POSITION_GAIN)
    assert catch_up(0.0, 9.0, 10.0, 0.0) == pytest.approx(SPEED_GAIN)


@given(st.floats(-500, 500), st.floats(0, 40), st.floats(0, 40), st.floats(-8, 8))
def test_comfort_bounds_are_never_exceeded(lag: float, speed: float, log_speed: float, log_acceleration: float) -> None:
    wanted = catch_up(lag, speed, log_speed, log_acceleration)
    assert -DECELERATION_MAX <= wanted <= ACCELERATION_MAX


@given(st.floats(-30, 30), st.floats(5, 25), st.floats(8, 25))
def test_lag_and_excess_die_out_without_a_wide_swing(lag: float, speed: float, log_speed: float) -> None:
    lags, excesses, _ = chase(lag, speed, log_speed, 60.0)
    assert abs(lags[-1]) < 0.1 and abs(excesses[-1]) < 0.05
    # a start at another speed than the log's carries it on, for at most the way that braking down to it takes
    carried = 4.0 + 0.5 * (speed - log_speed) ** 2 / ACCELERATION_MAX + abs(speed - log_speed)
    assert np.abs(lags).max() < abs(lag) + carried


def test_a_long_way_is_made_at_the_excess_speed_and_no_faster() -> None:
    lags, excesses, _ = chase(60.0, 10.0, 10.0, 40.0)
    assert excesses.max() == pytest.approx(SPEED_EXCESS, abs=0.05)
    assert abs(lags[-1]) < 0.1 and lags.min() > -0.5


def test_one_that_is_too_far_ahead_stops_at_worst() -> None:
    lags, excesses, _ = chase(-20.0, 2.0, 2.0, 60.0)
    assert abs(lags[-1]) < 0.1 and excesses.min() >= -2.0 - 1e-9


def test_a_log_in_waves_is_followed() -> None:
    lags, excesses, _ = chase(8.0, 10.0, 12.0, 40.0, wave=1.0)
    assert np.abs(lags[-100:]).max() < 0.1 and np.abs(excesses[-100:]).max() < 0.1
