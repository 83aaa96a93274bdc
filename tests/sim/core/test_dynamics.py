"""The bicycle model: closed forms, and limits that no command gets past."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.dynamics import Motion, VehicleLimits, bicycle_step
from litsim_sim.core.scene import STEP_S

LIMITS = VehicleLimits()
LENGTH = 4.5
ROUNDING = 1e-9

speeds = st.floats(0.0, LIMITS.speed_max)
headings = st.floats(-4.0, 4.0)
commands = st.floats(-1e3, 1e3)


def motion(speed: float = 10.0, yaw: float = 0.0, x: float = 0.0, y: float = 0.0) -> Motion:
    values = {"x": x, "y": y, "yaw": yaw, "speed": speed, "acceleration": 0.0, "yaw_rate": 0.0}
    return Motion(**{name: np.array([value]) for name, value in values.items()})


def step(at: Motion, acceleration: float, yaw_rate: float, length: float = LENGTH, limits: VehicleLimits = LIMITS):
    return bicycle_step(at, np.array([length]), np.array([acceleration]), np.array([yaw_rate]), limits)


def drive(at: Motion, steps: int, acceleration: float, yaw_rate: float) -> list[Motion]:
    out = [at]
    for _ in range(steps):
        out.append(step(out[-1], acceleration, yaw_rate))
    return out


def rear_axle(at: Motion, length: float = LENGTH) -> np.ndarray:
    lever = LIMITS.rear_axle * length
    return np.array([at.x - lever * np.cos(at.yaw), at.y - lever * np.sin(at.yaw)])


# Limits


@given(speeds, headings, commands, commands, st.floats(2.0, 25.0))
def test_limits_hold_whatever_is_commanded(
    speed: float, yaw: float, acceleration: float, yaw_rate: float, length: float
) -> None:
    before = motion(speed, yaw)
    after = step(before, acceleration, yaw_rate, length)
    mean_speed = 0.5 * (speed + after.speed[0])
    assert -LIMITS.deceleration_max - ROUNDING <= after.acceleration[0] <= LIMITS.acceleration_max + ROUNDING
    assert 0.0 <= after.speed[0] <= LIMITS.speed_max
    assert abs(after.yaw_rate[0]) * mean_speed <= LIMITS.lateral_acceleration_max + ROUNDING
    assert abs(after.yaw_rate[0]) <= LIMITS.curvature_max * mean_speed + ROUNDING
    # What is reported is what happened.
    assert after.speed[0] - speed == pytest.approx(after.acceleration[0] * STEP_S, abs=ROUNDING)
    assert after.yaw[0] - yaw == pytest.approx(after.yaw_rate[0] * STEP_S, abs=ROUNDING)


@given(speeds, st.floats(-LIMITS.deceleration_max, LIMITS.acceleration_max), st.floats(-0.1, 0.1))
def test_commands_within_the_limits_are_not_cut(speed: float, acceleration: float, yaw_rate: float) -> None:
    end = speed + acceleration * STEP_S
    mean = 0.5 * (speed + end)
    after = step(motion(speed), acceleration, yaw_rate)
    if 0.0 <= end <= LIMITS.speed_max:
        assert after.acceleration[0] == pytest.approx(acceleration, abs=1e-9)
        if abs(yaw_rate) <= LIMITS.curvature_max * mean and abs(yaw_rate) * mean <= LIMITS.lateral_acceleration_max:
            assert after.yaw_rate[0] == yaw_rate


def test_yaw_rate_is_cut_by_curvature_when_slow_and_by_grip_when_fast() -> None:
    slow, fast = step(motion(2.0), 0.0, 9.0), step(motion(30.0), 0.0, -9.0)
    assert slow.yaw_rate[0] == pytest.approx(LIMITS.curvature_max * 2.0)
    assert fast.yaw_rate[0] == pytest.approx(-LIMITS.lateral_acceleration_max / 30.0)


def test_other_limits_are_respected() -> None:
    tight = replace(LIMITS, acceleration_max=1.0, deceleration_max=2.0, speed_max=12.0, curvature_max=0.01)
    assert step(motion(10.0), 3.0, 0.0, limits=tight).acceleration[0] == pytest.approx(1.0)
    assert step(motion(10.0), -3.0, 0.0, limits=tight).acceleration[0] == pytest.approx(-2.0)
    assert step(motion(12.0), 3.0, 0.0, limits=tight).speed[0] == 12.0
    assert step(motion(10.0), 0.0, 3.0, limits=tight).yaw_rate[0] == pytest.approx(0.1)


@given(st.floats(LIMITS.speed_max, 90.0), commands)
def test_who_is_faster_than_the_top_speed_gains_nothing_and_brakes_no_harder_than_possible(
    speed: float, acceleration: float
) -> None:
    after = step(motion(speed), acceleration, 0.0)
    assert after.speed[0] <= speed
    assert after.acceleration[0] >= -LIMITS.deceleration_max - ROUNDING


# Straight on


@given(st.floats(5.0, 30.0), st.floats(-0.9, 2.0), headings)
def test_straight_motion_is_the_closed_form(speed: float, acceleration: float, yaw: float) -> None:
    end = drive(motion(speed, yaw, x=3.0, y=-4.0), 50, acceleration, 0.0)[-1]
    t = 50 * STEP_S
    gone = speed * t + 0.5 * acceleration * t**2
    assert end.x[0] == pytest.approx(3.0 + gone * np.cos(yaw), abs=1e-9)
    assert end.y[0] == pytest.approx(-4.0 + gone * np.sin(yaw), abs=1e-9)
    assert end.speed[0] == pytest.approx(speed + acceleration * t, abs=1e-9)
    assert end.yaw[0] == yaw


# At rest, and to rest


@given(headings, commands, st.floats(-1e3, 0.0))
def test_nothing_moves_or_rotates_at_rest(yaw: float, yaw_rate: float, acceleration: float) -> None:
    at = motion(0.0, yaw, x=5.0, y=6.0)
    after = step(at, acceleration, yaw_rate)
    for field in Motion._fields:
        assert getattr(after, field)[0] == getattr(at, field)[0], field


@given(speeds, headings, st.floats(-1e3, -0.5))
def test_braking_ends_at_rest_and_never_reverses(speed: float, yaw: float, acceleration: float) -> None:
    states = drive(motion(speed, yaw), 1000 if acceleration > -8 else 60, acceleration, 0.0)
    along = np.array([s.x[0] * np.cos(yaw) + s.y[0] * np.sin(yaw) for s in states])
    assert (np.diff(along) >= -ROUNDING).all()
    assert (np.diff([s.speed[0] for s in states]) <= 0).all()
    assert states[-1].speed[0] == 0.0
    assert states[-1].x == states[-2].x


def test_a_stop_within_a_step_reports_the_braking_that_was_needed() -> None:
    after = step(motion(0.2), -8.0, 0.0)
    assert (after.speed[0], after.acceleration[0]) == (0.0, pytest.approx(-2.0))
    assert after.x[0] == pytest.approx(0.5 * 0.2 * STEP_S)


# Turning


@pytest.mark.parametrize("yaw_rate", [0.3, -0.3, 0.05])
def test_a_constant_turn_is_a_circle(yaw_rate: float) -> None:
    speed = 10.0
    states = drive(motion(speed, yaw=0.7), 100, 0.0, yaw_rate)
    assert states[-1].yaw[0] == pytest.approx(0.7 + 100 * yaw_rate * STEP_S)
    axle = np.array([rear_axle(s)[:, 0] for s in states])
    # The rear axle's positions are vertices of a regular polygon; a chord spans one step's turn.
    radius = speed * STEP_S / (2.0 * np.sin(abs(yaw_rate) * STEP_S / 2.0))
    assert radius == pytest.approx(speed / abs(yaw_rate), rel=1e-3)
    to_middle = np.sign(yaw_rate) * radius * np.array([-np.sin(0.7), np.cos(0.7)])
    middle = axle[0] + to_middle
    np.testing.assert_allclose(np.hypot(*(axle - middle).T), radius, atol=1e-9)
    centre = np.array([[s.x[0], s.y[0]] for s in states])
    np.testing.assert_allclose(np.hypot(*(centre - middle).T), np.hypot(radius, LIMITS.rear_axle * LENGTH), atol=1e-9)


@given(speeds, headings, commands, commands, st.floats(2.0, 25.0))
def test_the_rear_axle_does_not_slip(
    speed: float, yaw: float, acceleration: float, yaw_rate: float, length: float
) -> None:
    before = motion(speed, yaw, x=100.0, y=-20.0)
    after = step(before, acceleration, yaw_rate, length)
    dx, dy = (rear_axle(after, length) - rear_axle(before, length))[:, 0]
    mean_yaw = 0.5 * (before.yaw[0] + after.yaw[0])
    across = dy * np.cos(mean_yaw) - dx * np.sin(mean_yaw)
    along = dx * np.cos(mean_yaw) + dy * np.sin(mean_yaw)
    assert across == pytest.approx(0.0, abs=1e-9)
    assert along == pytest.approx(0.5 * (speed + after.speed[0]) * STEP_S, abs=1e-9)


def test_vehicles_do_not_depend_on_each_other() -> None:
    rng = np.random.default_rng(4)
    count = 50
    at = Motion(*rng.uniform(-100, 100, (2, count)), *rng.uniform(0, 30, (4, count)))
    length, acceleration, yaw_rate = rng.uniform(3, 15, count), rng.normal(0, 5, count), rng.normal(0, 1, count)
    together = bicycle_step(at, length, acceleration, yaw_rate, LIMITS)
    for i in range(count):
        one = slice(i, i + 1)
        alone = Motion(*(values[one] for values in at))
        after = bicycle_step(alone, length[one], acceleration[one], yaw_rate[one], LIMITS)
        for field in Motion._fields:
            assert getattr(after, field)[0] == getattr(together, field)[i], field


def test_no_vehicles() -> None:
    none = np.empty(0)
    after = bicycle_step(Motion(none, none, none, none, none, none), none, none, none, LIMITS)
    assert all(values.shape == (0,) for values in after)
