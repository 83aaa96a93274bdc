"""Policy L: the log as it is, and the way back to it without a jump."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from litsim_sim.core.scene import ARRAY_FIELDS, STEP_S, AgentTable, Controller
from litsim_sim.world.log_policy import COMFORT_ACCELERATION, FADE_MIN_S, LogPolicy, Residual

Build = Callable[..., AgentTable]

offsets = st.floats(-15.0, 15.0)
rates = st.floats(-6.0, 6.0)
angles = st.floats(-0.5, 0.5)


@pytest.fixture(scope="module")
def policy(make_scenario: Any, track: Any) -> Callable[[], LogPolicy]:
    """A fresh policy on a log: 1 at constant speed, 2 accelerating, 3 askew and standing, 4 gone after step 20."""
    scenario = make_scenario(
        track(1, x=10.0, speed=15.0, last=150),
        track(2, x=10.0, y=-9.15, speed=5.0, acceleration=0.5, last=150),
        track(3, x=300.0, y=-1.83, speed=0.0, yaw=0.05, last=150),
        track(4, x=200.0, y=-1.83, speed=10.0, last=20),
    )
    return lambda: LogPolicy(scenario.log)


def displaced(table: AgentTable, agent: int, **by: float) -> AgentTable:
    """`table` with `agent` under POLICY and its columns moved."""
    row = table.row(agent)
    table.controller[row] = Controller.POLICY
    for column, amount in by.items():
        getattr(table, column)[row] += amount
    return table


def residual(position: tuple[float, float], velocity: tuple[float, float], yaw: float, build: Build) -> Residual:
    """The residual of an agent that is off a logged one at 20 m/s along +x by these."""
    vx, vy = 20.0 + velocity[0], velocity[1]
    moves = {"yaw": float(np.arctan2(vy, vx)), "speed": float(np.hypot(vx, vy))}
    off = build(5, {"id": 1, "x": 50.0 + position[0], "y": position[1], **moves})
    logged = build(5, {"id": 1, "x": 50.0, "speed": 20.0})
    return replace(Residual.between(off, 0, logged, 0), yaw=yaw)


# Residual


@given(offsets, offsets, rates, rates, angles)
def test_a_residual_starts_where_the_agent_is_and_ends_on_the_log(
    agent_table: Build, dx: float, dy: float, vx: float, vy: float, yaw: float
) -> None:
    start = residual((dx, dy), (vx, vy), yaw, agent_table)
    off = start.at(start.step)
    np.testing.assert_array_equal(off.position, start.position)
    np.testing.assert_array_equal(off.velocity, start.velocity)
    assert off.yaw == start.yaw
    np.testing.assert_allclose(off.position, [dx, dy], atol=1e-9)
    np.testing.assert_allclose(off.velocity, [vx, vy], atol=1e-9)
    for after in (0, 1, 50):
        off = start.at(start.step + start.steps + after)
        assert off.position.tolist() == off.velocity.tolist() == off.acceleration.tolist() == [0.0, 0.0]
        assert off.yaw == off.yaw_rate == 0.0


@given(offsets, offsets, rates, rates)
def test_velocity_is_the_rate_of_the_position(agent_table: Build, dx: float, dy: float, vx: float, vy: float) -> None:
    start = residual((dx, dy), (vx, vy), 0.0, agent_table)
    steps = range(start.step, start.step + start.steps + 3)
    position, velocity = (np.array([getattr(start.at(step), of) for step in steps]) for of in ("position", "velocity"))
    mean_velocity = 0.5 * (velocity[1:] + velocity[:-1])
    # The trapezoidal rule is off by at most jerk * dt^3 / 12 in a step; the blends' jerk peaks at their start.
    jerk = np.hypot(*(60 * start.position)) / (start.steps * STEP_S) ** 3
    jerk += np.hypot(*(36 * start.velocity)) / (start.steps * STEP_S) ** 2
    np.testing.assert_allclose(np.diff(position, axis=0), mean_velocity * STEP_S, atol=jerk * STEP_S**3 / 12 + 1e-12)


@given(offsets, offsets, rates, rates, angles)
def test_acceleration_and_yaw_rate_are_the_rates_of_velocity_and_heading(
    agent_table: Build, dx: float, dy: float, vx: float, vy: float, yaw: float
) -> None:
    start = residual((dx, dy), (vx, vy), yaw, agent_table)
    fade = [start.at(step) for step in range(start.step, start.step + start.steps + 1)]
    for rate, of, within in (("acceleration", "velocity", 1e-9), ("yaw_rate", "yaw", 1e-3)):
        rates, values = (np.array([getattr(off, name) for off in fade]) for name in (rate, of))
        mean = (rates[:-2] + 4.0 * rates[1:-1] + rates[2:]) / 6.0  # by Simpson's rule, exact for cubics
        np.testing.assert_allclose(mean, (values[2:] - values[:-2]) / (2.0 * STEP_S), atol=within)


def test_who_comes_back_accelerates_as_its_speed_changes(policy: Callable[[], LogPolicy]) -> None:
    log = policy()
    log.release(displaced(log.table(50), 1, x=-2.0, speed=-1.5, yaw=0.03), 1)
    tables = [log.table(step) for step in range(51, 80)]
    speed, acceleration, yaw, yaw_rate = (
        np.array([getattr(table, name)[table.row(1)] for table in tables])
        for name in ("speed", "acceleration", "yaw", "yaw_rate")
    )
    assert np.abs(acceleration).max() > 0.5, "the log drives at constant speed"
    np.testing.assert_allclose(np.diff(speed) / STEP_S, 0.5 * (acceleration[1:] + acceleration[:-1]), atol=0.05)
    np.testing.assert_allclose(np.diff(yaw) / STEP_S, 0.5 * (yaw_rate[1:] + yaw_rate[:-1]), atol=0.005)


def test_the_fade_is_as_long_as_the_residual_asks(agent_table: Build) -> None:
    def steps(dx: float, vx: float) -> int:
        return residual((dx, 0.0), (vx, 0.0), 0.0, agent_table).steps

    assert steps(0.0, 0.0) == round(FADE_MIN_S / STEP_S)
    assert steps(6.0, 0.0) == int(np.ceil(np.sqrt(5.77 * 6.0 / COMFORT_ACCELERATION) / STEP_S))
    assert steps(0.0, 3.0) == int(np.ceil(3.94 * 3.0 / COMFORT_ACCELERATION / STEP_S))
    assert steps(6.0, 3.0) > max(steps(6.0, 0.0), steps(0.0, 3.0))


def test_headings_fade_over_the_shorter_way_round(agent_table: Build) -> None:
    off = agent_table(0, {"id": 1, "yaw": -3.1})
    logged = agent_table(0, {"id": 1, "yaw": 3.1})
    assert Residual.between(off, 0, logged, 0).yaw == pytest.approx(2 * np.pi - 6.2)


# LogPolicy


def test_without_a_release_it_is_the_log(policy: Callable[[], LogPolicy]) -> None:
    fresh = policy()
    for step in (0, 1, 20, 21, 150, 151, -1):
        table, logged = fresh.table(step), fresh.log.table(step)
        assert table.step == step
        for field in ARRAY_FIELDS:
            np.testing.assert_array_equal(getattr(table, field), getattr(logged, field), field)
    assert 4 in fresh.table(20).id
    assert 4 not in fresh.table(21).id
    assert len(fresh.table(151)) == 0


@settings(max_examples=60)
@given(
    agent=st.sampled_from([1, 2]),
    dx=st.floats(-8, 8),
    dy=st.floats(-2, 2),
    speed=st.floats(-3, 3),
    yaw=st.floats(-0.15, 0.15),
)
def test_a_released_agent_comes_back_without_a_jump(
    policy: Callable[[], LogPolicy], agent: int, dx: float, dy: float, speed: float, yaw: float
) -> None:
    """Continuous in position, speed and heading from the release to the log, and on the log from then on."""
    fresh, release = policy(), 10
    off = displaced(fresh.table(release), agent, x=dx, y=dy, speed=speed, yaw=yaw)
    fresh.release(off, agent)
    tables = [off] + [fresh.table(step) for step in range(release + 1, 151)]
    rows = [table.row(agent) for table in tables]
    x, y, v, heading = (
        np.array([getattr(t, f)[r] for t, r in zip(tables, rows, strict=True)]) for f in ("x", "y", "speed", "yaw")
    )
    logged = [fresh.log.table(table.step) for table in tables]
    on_log = np.array([[lg.x[r], lg.y[r], lg.speed[r]] for lg, r in zip(logged, rows, strict=True)])
    log_velocity = np.diff(on_log[:, :2], axis=0) / STEP_S
    # Beside the log: at first as fast as at the release, from then on never changed more than is comfortable.
    extra = np.column_stack([np.diff(x), np.diff(y)]) / STEP_S - log_velocity
    first_rate = np.array([v[0] * np.cos(heading[0]), v[0] * np.sin(heading[0])]) - [on_log[0, 2], 0.0]
    np.testing.assert_allclose(extra[0], first_rate, atol=1.01 * COMFORT_ACCELERATION * STEP_S)
    assert np.hypot(*np.diff(extra, axis=0).T).max() <= 1.01 * COMFORT_ACCELERATION * STEP_S
    # Log and fade change the speed, and so does turning the heading that it is measured along.
    assert np.abs(np.diff(v)).max() <= 1.01 * (COMFORT_ACCELERATION + 0.5 + 6.0 * abs(yaw)) * STEP_S
    assert np.abs(np.diff(heading)).max() <= 1.88 * abs(yaw) / FADE_MIN_S * STEP_S + 1e-9
    back = slice(Residual.between(off, rows[0], logged[0], rows[0]).steps, None)
    assert len(x[back]) > 0
    np.testing.assert_array_equal(np.column_stack([x, y, v])[back], on_log[back])


def test_only_the_released_agent_is_moved(policy: Callable[[], LogPolicy]) -> None:
    fresh = policy()
    fresh.release(displaced(fresh.table(10), 1, x=5.0), 1)
    table, logged = fresh.table(11), fresh.log.table(11)
    others = table.id != 1
    for field in ARRAY_FIELDS:
        np.testing.assert_array_equal(getattr(table, field)[others], getattr(logged, field)[others], field)
    assert table.x[table.row(1)] != logged.x[logged.row(1)]
    assert (table.controller == Controller.LOG).all()


def test_a_second_release_replaces_the_first(policy: Callable[[], LogPolicy]) -> None:
    fresh = policy()
    fresh.release(displaced(fresh.table(10), 1, x=5.0), 1)
    again = displaced(fresh.log.table(20), 1, x=-3.0)
    fresh.release(again, 1)
    table, logged = fresh.table(21), fresh.log.table(21)
    assert -3.1 < table.x[table.row(1)] - logged.x[logged.row(1)] < -2.9


def test_speeds_never_become_negative(policy: Callable[[], LogPolicy]) -> None:
    fresh = policy()
    fresh.release(displaced(fresh.table(10), 3, x=3.0), 3)  # 3 m ahead of where its log stands
    speeds = [table.speed[table.row(3)] for table in map(fresh.table, range(11, 80))]
    assert min(speeds) >= 0.0


def test_release_of_an_agent_whose_log_is_over_changes_nothing(policy: Callable[[], LogPolicy]) -> None:
    fresh = policy()
    gone = displaced(fresh.table(20), 4, x=5.0)
    for step in (25, 200):  # others are still there; nobody is
        fresh.release(AgentTable(step, *(getattr(gone, f) for f in ARRAY_FIELDS)), 4)
        assert 4 not in fresh.table(step + 1).id


def test_an_agent_that_leaves_while_fading_is_gone(policy: Callable[[], LogPolicy]) -> None:
    fresh = policy()
    fresh.release(displaced(fresh.table(15), 4, x=5.0), 4)
    assert fresh.table(20).x[fresh.table(20).row(4)] > fresh.log.table(20).x[fresh.log.table(20).row(4)]
    assert 4 not in fresh.table(21).id


# Late


@pytest.mark.parametrize(("agent", "x", "y"), [(1, -20.0, 0.3), (2, -6.3, -0.4), (1, -0.2, 0.0)])
def test_who_is_released_late_follows_its_log_with_that_lag(
    policy: Callable[[], LogPolicy], agent: int, x: float, y: float
) -> None:
    fresh, release = policy(), 60
    log = fresh.log
    off = displaced(fresh.table(release), agent, x=x, y=y)
    lag = int(log.lags(np.array([log.row(agent)]), release, *(getattr(off, f)[[off.row(agent)]] for f in "xy"))[0])
    fresh.release(off, agent, with_lag=True)
    tables = [off] + [fresh.table(step) for step in range(release + 1, 151)]
    for before, after in pairwise(tables):
        i, j = before.row(agent), after.row(agent)
        moved = np.hypot(after.x[j] - before.x[i], after.y[j] - before.y[i])
        assert moved <= 0.1 * max(before.speed[i], after.speed[j]) + 0.1, "no jump"
    last, logged = tables[-1], log.table(150 - lag)
    assert last.x[last.row(agent)] == pytest.approx(logged.x[logged.row(agent)], abs=1e-9)
    others = [a for a in log.ids.tolist() if a != agent and last.row(a) >= 0]
    on_time = log.table(150)
    assert all(last.x[last.row(a)] == on_time.x[on_time.row(a)] for a in others)


def test_who_is_late_leaves_late_and_a_release_on_time_ends_it(policy: Callable[[], LogPolicy]) -> None:
    fresh = policy()
    fresh.release(displaced(fresh.table(15), 4, x=-5.0), 4, with_lag=True)
    assert [fresh.table(step).row(4) >= 0 for step in (20, 25, 26)] == [True, True, False]
    fresh.release(displaced(fresh.table(18), 4), 4)
    assert [fresh.table(step).row(4) >= 0 for step in (20, 21)] == [True, False]


def test_who_is_displaced_is_off_the_time_or_off_the_place_of_its_log(make_scenario: Any, track: Any) -> None:
    policy = LogPolicy(make_scenario(track(1, x=100.0), track(2, x=60.0), track(3, x=20.0)).log)
    table = policy.table(10)
    assert not policy.displaced(table).any()
    table.x[table.row(2)] -= 0.3
    table.x[table.row(3)] -= 5.0
    policy.release(table, 2)
    policy.release(table, 3, with_lag=True)
    assert policy.displaced(policy.table(11)).tolist() == [False, True, True]
    assert policy.displaced(policy.table(60)).tolist() == [False, False, True], "residuals fade, lags stay"
