"""Futures of agents by compiled loops, against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.conflict import futures
from litsim_policy.conflict.futures import XX, XY, YAW, PredictedMotion, X, Y
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S

seeds = st.integers(0, 2**32)


@given(seeds, st.integers(1, 12), st.integers(1, 9))
def test_logs_go_on_with_the_residuals_of_those_that_follow_them(seed: int, agents: int, count: int) -> None:
    random = np.random.default_rng(seed)
    x, y, yaw = random.normal(0.0, 50.0, (3, 6, 20))
    valid = random.random((6, 20)) < 0.8
    rows, now = random.integers(0, 6, agents), random.integers(-12, 32, agents)
    here_x, here_y = random.normal(0.0, 50.0, (2, agents))
    on_log = random.random(agents) < 0.5
    states, found = futures.follow_logs(x, y, yaw, valid, rows, now, count, here_x, here_y, on_log)

    steps = now[:, None] + np.arange(1, count + 1)
    at, here = np.clip(steps, 0, 19), np.clip(now, 0, 19)
    kept = on_log & valid[rows, here]
    for column, values, place in ((X, x, here_x), (Y, y, here_y)):
        residual = np.where(kept, place - values[rows, here], 0.0)
        assert (states[..., column] == values[rows[:, None], at] + residual[:, None]).all()
    assert (states[..., YAW] == yaw[rows[:, None], at]).all() and (states[..., XX:] == 0.0).all()
    assert (found == (valid[rows[:, None], at] & (steps >= 0) & (steps <= 19))).all()


@given(seeds, st.sampled_from([0.1, 0.2, 0.25, 0.4]), st.integers(0, 12), st.floats(0.0, 3.0))
def test_forecasts_are_interpolated_as_numpy_does_it(seed: int, dt: float, instants: int, scale: float) -> None:
    random = np.random.default_rng(seed)
    mean = random.normal(0.0, 50.0, (5, instants, 2))
    yaw = random.uniform(-3.5, 3.5, (5, instants)).astype(np.float32)
    sigmas = random.uniform([0.1, 0.1, -0.9], [5.0, 2.0, 0.9], (5, instants, 3)).astype(np.float32)
    rows, count = np.array([3, -1, 0, 4]), 30
    now = random.normal(0.0, 3.0, (3, 4))
    states, valid = futures.interpolate(mean, yaw, sigmas, dt, rows, count, scale, *now)

    times, instant_times = STEP_S * np.arange(1, count + 1), dt * np.arange(instants + 1)
    reached = times <= instant_times[-1] + 1e-9
    assert (valid == (reached & (rows >= 0)[:, None] & (instants > 0))).all()
    for k, row in enumerate(rows):
        if row < 0 or not instants:
            assert (states[k] == 0.0).all()
            continue
        turns = np.unwrap(np.concatenate([[0.0], wrap_angle(yaw[row].astype(np.float64) - now[2, k])]))
        sigma_x, sigma_y, rho = sigmas[row].astype(np.float64).T
        series = [*np.concatenate([now[:2, k][None], mean[row]]).T, now[2, k] + turns]
        series += [scale**2 * np.concatenate([[0.0], v]) for v in (sigma_x**2, sigma_y**2, rho * sigma_x * sigma_y)]
        for column, values in enumerate(series):
            expected = np.interp(times[reached], instant_times, values)
            assert states[k, reached, column] == pytest.approx(expected, abs=1e-6)


@given(seeds, st.floats(0.0, 30.0), st.floats(2.0, 9.0), st.floats(0.0, 2.0))
def test_a_forecast_is_held_back_to_the_arc_length_that_braking_reaches(seed, speed, braking, braking_time) -> None:
    random = np.random.default_rng(seed)
    states = np.zeros((30, 6))
    states[:, :YAW] = np.cumsum(random.normal([1.5, 0.0], 0.3, (30, 2)), axis=0)
    places = np.concatenate([[[0.0, 0.0]], states[:, :YAW]])
    before = states.copy()
    futures.hold_back(states, 0.0, 0.0, speed, braking, braking_time)

    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    for t in range(30):
        gone, now, left = 0.0, speed, braking_time
        for _ in range(10 * (t + 1)):  # of 0.01 s
            slower = max(now - (braking * min(left, 0.01)), 0.0)
            gone, now, left = gone + 0.005 * (now + slower), slower, max(left - 0.01, 0.0)
        reach = min(gone, travelled[t + 1])
        expected = [np.interp(reach, travelled, places[:, axis]) for axis in (0, 1)]
        assert states[t, :YAW] == pytest.approx(expected, abs=0.02)
    assert (states[:, YAW:] == before[:, YAW:]).all()


def test_who_has_braked_to_a_stand_is_held_there_though_it_is_expected_to_stand_on_before_it_drives_off() -> None:
    """Its forecast does not move at first, so that no share of its first way leads to where it is."""
    states = np.zeros((6, 6))
    states[:, X] = [5.0, 5.0, 5.1, 5.3, 5.6, 6.0]
    futures.hold_back(states, 5.0, 0.0, 0.0, 2.0, 1.0)
    assert (states[:, X] == 5.0).all() and (states[:, Y] == 0.0).all()


@given(seeds)
def test_bounds_hold_the_centres_while_they_are_valid_and_the_largest_spread(seed: int) -> None:
    random = np.random.default_rng(seed)
    motion = PredictedMotion(random.normal(0.0, 9.0, (7, 5, 6)) ** 2, random.random((7, 5)) < 0.6)
    low = [np.where(motion.valid, v, np.inf).min(axis=1) for v in (motion.x, motion.y)]
    high = [np.where(motion.valid, v, -np.inf).max(axis=1) for v in (motion.x, motion.y)]
    spread = np.sqrt(motion.covariance[..., 0] + motion.covariance[..., 1]).max(axis=1)
    assert (motion.bounds == np.column_stack([*low, *high, spread])).all()


def test_some_agents_futures_are_replaced_by_others() -> None:
    one = PredictedMotion(np.zeros((3, 2, XY + 1)), np.zeros((3, 2), np.bool_))
    other = PredictedMotion(np.ones((3, 2, XY + 1)), np.ones((3, 2), np.bool_))
    one.put(np.zeros(3, np.bool_), other)
    assert not one.states.any() and not one.valid.any()
    one.put(np.array([False, True, False]), other)
    assert one.states[:, 0, 0].tolist() == [0.0, 1.0, 0.0] and one.valid[:, 0].tolist() == [False, True, False]
