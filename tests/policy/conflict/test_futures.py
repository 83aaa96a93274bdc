"""Where agents will be, by logs, by forecasts and on planned paths; loops over agents and steps against plain numpy."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.futures import Futures, PlannedPaths, follow_logs, go_as_planned, hold_back, interpolate
from litsim_policy.conflict.predicted_motion import XX, XY, YAW, YY, PredictedMotion, X, Y
from litsim_policy.motion.path_batch import PathBatch
from litsim_predictor.forecast import Forecast, Modes
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, AgentTable, Controller
from litsim_sim.scenario.log import Log
from made_agents import straight_on

NOW = 5  # step at which agents are looked at
STEPS = 30
STRAIGHT = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
CORNER = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 100.0]])
TIME = 0.1 * np.arange(1, STEPS + 1)
seeds = st.integers(0, 2**32)


def everybody(log: Log, table: AgentTable, forecast: Forecast, config: ConflictConfig, lag=None) -> Futures:
    futures, mask = Futures(log, config, table, forecast, lag), np.ones(len(table), np.bool_)
    futures.cover(mask, mask)
    return futures


def forecast_of(
    log: Log, table: AgentTable, forecast: Forecast, config: ConflictConfig | None = None
) -> PredictedMotion:
    return everybody(log, table, forecast, config or ConflictConfig()).expected


def test_an_ego_that_brakes_hard_is_expected_to_go_on_for_a_second(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log

    def ahead(**values: float) -> np.ndarray:
        table = placed(log.table(NOW), 1, controller=Controller.EGO, **values)
        return forecast_of(log, table, straight_on(table)).x[0] - table.x[0]

    assert ahead(acceleration=-6.0)[[9, 29]] == pytest.approx([7.0, 7.0 + 4.0 * 2.0])
    assert ahead(acceleration=-6.0, speed=3.0)[[4, 9, 29]] == pytest.approx([0.75, 0.75, 0.75]), "then it stands"
    assert ahead(acceleration=-0.9)[29] == pytest.approx(30.0), "that is not hard"


def test_an_ego_that_stands_is_expected_to_stand_until_it_starts(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log

    def moves(**values: float) -> float:
        table = placed(log.table(NOW), 1, controller=Controller.EGO, **values)
        drifting = straight_on(placed(table, 1, speed=2.0, yaw=0.2))
        expected = forecast_of(log, table, drifting)
        assert expected.valid[0].all()
        return float(np.hypot(expected.x[0, -1] - table.x[0], expected.y[0, -1] - table.y[0]))

    assert moves(speed=0.0) == 0.0
    assert moves(speed=0.0, acceleration=0.5) == pytest.approx(6.0)
    assert moves(speed=1.0) == pytest.approx(6.0)


def test_an_agent_that_keeps_its_speed_is_not_held_back_even_if_all_braking_is_hard(
    make_scenario, track, placed
) -> None:
    """Its speed used to be divided by a deceleration of zero, which left its future infinite."""
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    config = ConflictConfig(emergency=0.0)
    for speed in (10.0, 0.0):
        table = placed(log.table(NOW), 1, controller=Controller.POLICY, acceleration=0.0, speed=speed)
        expected = speed * STEP_S * np.arange(1, 31)
        assert forecast_of(log, table, straight_on(table), config).x[0] - table.x[0] == pytest.approx(expected)


def test_agents_under_control_are_expected_where_they_are_forecast_unless_in_an_emergency(
    make_scenario, track, placed
) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    table = placed(log.table(NOW), 2, controller=Controller.POLICY, acceleration=-3.9)
    assert forecast_of(log, table, straight_on(table)).x[1] - table.x[1] == pytest.approx(np.arange(1.0, 31.0))


# Against numpy


@given(seeds, st.integers(1, 12), st.integers(1, 9))
def test_logs_go_on_with_the_residuals_of_those_that_follow_them(seed: int, agents: int, count: int) -> None:
    random = np.random.default_rng(seed)
    x, y, yaw = random.normal(0.0, 50.0, (3, 6, 20))
    valid = random.random((6, 20)) < 0.8
    rows, now = random.integers(0, 6, agents), random.integers(-12, 32, agents)
    here_x, here_y = random.normal(0.0, 50.0, (2, agents))
    on_log = random.random(agents) < 0.5
    states, found = follow_logs((x, y, yaw, valid), rows, now, count, here_x, here_y, on_log)

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
    states, valid = interpolate((mean, yaw, sigmas), dt, rows, count, scale, tuple(now))

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
    hold_back(states, 0.0, 0.0, speed, braking, braking_time)

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
    hold_back(states, 5.0, 0.0, 0.0, 2.0, 1.0)
    assert (states[:, X] == 5.0).all() and (states[:, Y] == 0.0).all()


def test_some_agents_futures_are_replaced_by_others() -> None:
    one = PredictedMotion(np.zeros((3, 2, XY + 1)), np.zeros((3, 2), np.bool_))
    other = PredictedMotion(np.ones((3, 2, XY + 1)), np.ones((3, 2), np.bool_))
    one.put(np.zeros(3, np.bool_), other)
    assert not one.states.any() and not one.valid.any()
    one.put(np.array([False, True, False]), other)
    assert one.states[:, 0, 0].tolist() == [0.0, 1.0, 0.0] and one.valid[:, 0].tolist() == [False, True, False]


# Planned motion


def go_on(agent_table, path: np.ndarray, *, forecast: float | None = None, fresh: bool = False, **agent: float):
    """Motion of agent 7, which is on `path`, where the forecast has it at a speed [m/s], or knows nothing of it."""
    table = agent_table(3, {"id": 2, "x": 50.0}, {"id": 7, **agent})
    states, valid = np.zeros((2, STEPS, 6)), np.full((2, STEPS), forecast is not None)
    states[1, :, 0], states[1, :, 1] = table.x[1] + (forecast or 0.0) * TIME, table.y[1]
    go_as_planned(PathBatch.of([path]), np.array([1]), np.array([fresh]), table.arrays, 1.0, states, valid)
    assert not states[0].any()
    return PredictedMotion(states[1:], valid[1:])


def test_it_keeps_its_braking_for_a_while_and_comes_to_its_path(agent_table) -> None:
    found = go_on(agent_table, STRAIGHT, x=10.0, y=2.0, speed=10.0, acceleration=-4.0)
    gone = np.where(TIME <= 1.0, 10.0 * TIME - 2.0 * TIME**2, 8.0 + 6.0 * (TIME - 1.0))
    np.testing.assert_allclose(found.x[0], 10.0 + gone, atol=1e-9)
    np.testing.assert_allclose(found.y[0], 2.0 * np.exp(-TIME), atol=1e-9)
    assert found.valid.all() and not len(found.alternatives)
    along, across = found.states[0, -1, [XX, YY]]
    assert along > 25.0 * across > 0.0, "where to is known better than how fast"


def test_who_has_stopped_does_not_reverse(agent_table) -> None:
    found = go_on(agent_table, STRAIGHT, x=10.0, speed=2.0, acceleration=-4.0)
    assert found.x[0, -1] == pytest.approx(10.5) and (np.diff(found.x[0]) >= 0.0).all()


def test_it_takes_the_turn_that_its_path_takes_whatever_the_forecast_says(agent_table) -> None:
    found = go_on(agent_table, CORNER, x=10.0, speed=10.0, forecast=10.0)
    assert (found.x[0, -1], found.y[0, -1]) == pytest.approx((20.0, 20.0))
    assert found.yaw[0, -1] == pytest.approx(np.pi / 2)
    assert found.states[0, -1, YY] > found.states[0, -1, XX], "the spread turns with the path"


def test_how_far_it_gets_is_first_its_own_and_later_the_forecast_s(agent_table) -> None:
    found = go_on(agent_table, STRAIGHT, x=10.0, speed=10.0, forecast=4.0)
    assert found.x[0, 9] == pytest.approx(20.0), "after 1 s as it drives now"
    assert found.x[0, 19] == pytest.approx(10.0 + 0.5 * (20.0 + 8.0)), "after 2 s half of both"
    assert found.x[0, 29] == pytest.approx(10.0 + 12.0), "after 3 s as it is forecast"


def test_whose_policy_has_done_nothing_yet_gets_as_far_as_it_is_forecast(agent_table) -> None:
    found = go_on(agent_table, CORNER, x=10.0, speed=10.0, forecast=5.0, fresh=True)
    assert found.x[0, 9] == pytest.approx(15.0) and found.y[0, 29] == pytest.approx(5.0)


def test_planned_paths_follow_their_agents_into_a_part_of_the_table() -> None:
    planned = PlannedPaths(np.array([5, 8]), PathBatch.of([CORNER, STRAIGHT]), np.array([True, False]))
    some = planned.moved_to(np.array([1, 5, 8, 9]))
    assert some.rows.tolist() == [1, 2] and some.fresh.tolist() == [True, False]
    np.testing.assert_array_equal(some.paths.point(np.array([30.0, 30.0])), [[20.0, 10.0], [30.0, 0.0]])


def test_what_is_expected_of_some_first_and_of_others_later_is_what_is_of_all_at_once(make_scenario, track) -> None:
    """Of agents under control, one with another manoeuvre, and one on a lagged log."""
    log = make_scenario(*(track(agent, x=30.0 * agent) for agent in range(1, 7))).log
    table, forecast = log.table(5), straight_on(log.table(5))
    row, chance = np.array([1, 4]), np.array([0.3, 0.4], np.float32)
    modes = Modes(row, chance, forecast.mean[row] + 1.0, forecast.yaw[row], forecast.covariance[row])
    forecast = replace(forecast, modes=modes, maneuver_probability=np.full((6, 2), 0.5, np.float32))
    keep = table.id == 6

    def planned(among: np.ndarray) -> PlannedPaths:
        rows = np.array([2, 3])[among[[2, 3]]]
        return PlannedPaths(rows, PathBatch.of([STRAIGHT if r == 2 else CORNER for r in rows]), rows == 3)

    lag = np.where(keep, 2, 0)
    now, later = (Futures(log, ConflictConfig(), table, forecast, lag, keep, planned) for _ in range(2))
    every = np.ones(6, np.bool_)
    now.cover(every, every)
    for asked in ([1, 3], [2, 5], [3, 4, 6]):
        later.cover(every, np.isin(table.id, asked))
        known = np.isin(table.id, asked)
        np.testing.assert_array_equal(later.expected.states[known], now.expected.states[known])
    np.testing.assert_array_equal(later.expected.states, now.expected.states)
    np.testing.assert_array_equal(later.expected.valid, now.expected.valid)
    mine, whole = later.expected.alternatives, now.expected.alternatives
    order = np.argsort(mine.row)
    for name in ("row", "weight", "states", "valid"):
        np.testing.assert_array_equal(getattr(mine, name)[order], getattr(whole, name))
    assert whole.row.tolist() == [1, 4]
