"""The futures that conflict detection compares, by logs and by forecasts."""

from __future__ import annotations

import numpy as np
import pytest
from litsim_policy.conflict.agent_futures import AgentFutures

from constant_motion import straight_on
from litsim_policy.conflict.config import ConflictConfig
from litsim_sim.core.scene import STEP_S, Controller

NOW = 5  # step at which agents are looked at


def test_an_agent_that_rejoins_its_log_keeps_its_residual_in_the_future(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    futures = AgentFutures(log, ConflictConfig())
    logged = futures.logged(log.table(NOW))
    shifted = futures.logged(placed(log.table(NOW), 2, x=log.x[1, NOW] - 3.0, y=log.y[1, NOW] + 0.5))
    assert shifted.x[1] == pytest.approx(logged.x[1] - 3.0) and shifted.y[1] == pytest.approx(logged.y[1] + 0.5)
    held = placed(log.table(NOW), 2, x=log.x[1, NOW] - 3.0, controller=1)
    assert futures.logged(held).x[1] == pytest.approx(logged.x[1]), "put back at once"


def test_logged_futures_lie_at_the_steps_up_to_the_horizon(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0, last=20), track(2, x=80.0, last=40)).log
    future = AgentFutures(log, ConflictConfig(horizon=3.0)).logged(log.table(NOW))
    assert future.x.shape == (2, 30)
    assert future.x[1, :3] == pytest.approx([86.0, 87.0, 88.0])
    assert future.valid[0].sum() == 15, "the ego's log ends at step 20, 1.5 s from now"


def test_a_log_that_is_late_goes_on_late(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0, last=20), track(2, x=80.0, last=40)).log
    lag = np.array([0, 4])
    table = log.table(NOW, lag)
    future = AgentFutures(log, ConflictConfig()).logged(table, lag)
    assert table.x[1] == pytest.approx(81.0) and future.x[1, :3] == pytest.approx([82.0, 83.0, 84.0])


@pytest.mark.parametrize("dt", [0.1, 0.2, 0.5, 0.3])
def test_a_forecast_of_any_dt_becomes_one_of_every_step(make_scenario, track, dt: float) -> None:
    log = make_scenario(track(1, x=100.0, yaw=0.05), track(2, x=80.0)).log
    table = log.table(NOW)
    futures = AgentFutures(log, ConflictConfig(horizon=3.0))
    future = futures.forecast(table, straight_on(table, 3.0, dt))
    t = 0.1 * np.arange(1, 31)
    assert future.x[0] == pytest.approx(table.x[0] + 10.0 * t * np.cos(0.05))
    assert future.y[0] == pytest.approx(table.y[0] + 10.0 * t * np.sin(0.05)) and future.valid.all()
    xx, yy, xy = future.covariance[0].T
    reached = t >= dt - 1e-9
    assert xx[reached] == pytest.approx(1.0) and yy[reached] == pytest.approx(0.25) and xy == pytest.approx(0.0)
    assert (np.diff(xx[~reached]) > 0).all(), "from certain to as uncertain as the first instant"


def test_beyond_the_end_of_a_forecast_nothing_is_known(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    futures = AgentFutures(log, ConflictConfig(horizon=3.0))
    future = futures.forecast(log.table(NOW), straight_on(log.table(NOW), 2.0))
    assert future.valid[0].tolist() == [True] * 20 + [False] * 10


def test_headings_are_interpolated_the_short_way_round(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    table = placed(log.table(NOW), 1, yaw=np.pi - 0.05)
    forecast = straight_on(table)
    forecast.yaw[0] = -np.pi + 0.05
    future = AgentFutures(log, ConflictConfig()).forecast(table, forecast)
    assert np.cos(future.yaw[0]).max() < -0.99, "never across 0"


def test_an_ego_that_brakes_hard_is_expected_to_go_on_for_a_second(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    futures = AgentFutures(log, ConflictConfig(horizon=3.0))

    def ahead(**values: float) -> np.ndarray:
        table = placed(log.table(NOW), 1, controller=Controller.EGO, **values)
        return futures.forecast(table, straight_on(table)).x[0] - table.x[0]

    assert ahead(acceleration=-6.0)[[9, 29]] == pytest.approx([7.0, 7.0 + 4.0 * 2.0])
    assert ahead(acceleration=-6.0, speed=3.0)[[4, 9, 29]] == pytest.approx([0.75, 0.75, 0.75]), "then it stands"
    assert ahead(acceleration=-0.9)[29] == pytest.approx(30.0), "that is not hard"


def test_an_agent_that_keeps_its_speed_is_not_held_back_even_if_all_braking_is_hard(
    make_scenario, track, placed
) -> None:
    """Its speed used to be divided by a deceleration of zero, which left its future infinite."""
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    futures = AgentFutures(log, ConflictConfig(horizon=3.0, braking_hard=0.0, emergency=0.0))
    for speed in (10.0, 0.0):
        table = placed(log.table(NOW), 1, controller=Controller.EGO, acceleration=0.0, speed=speed)
        expected = speed * STEP_S * np.arange(1, 31)
        assert futures.forecast(table, straight_on(table)).x[0] - table.x[0] == pytest.approx(expected)


def test_agents_under_control_are_expected_where_they_are_forecast_unless_in_an_emergency(
    make_scenario, track, placed
) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    futures = AgentFutures(log, ConflictConfig(horizon=3.0))
    table = placed(log.table(NOW), 2, controller=Controller.POLICY, acceleration=-3.9)
    assert futures.forecast(table, straight_on(table)).x[1] - table.x[1] == pytest.approx(np.arange(1.0, 31.0))


def test_spreads_are_scaled_and_keep_their_shape(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    table = log.table(NOW)
    forecast = straight_on(table)
    forecast.covariance[:] = [2.0, 0.5, 0.4]  # sigma along x and y [m], and their correlation
    future = AgentFutures(log, ConflictConfig(sigma_scale=3.0)).forecast(table, forecast)
    assert future.covariance[0, -1] == pytest.approx([9.0 * 4.0, 9.0 * 0.25, 9.0 * 0.4 * 2.0 * 0.5], rel=1e-6)
