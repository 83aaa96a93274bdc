"""The kinematic predictor on motions whose future is known."""

from collections.abc import Callable
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_predictor.forecast import Forecast, Scope, Wanted
from litsim_predictor.kinematic import RATE_DECAY, KinematicConfig, KinematicPredictor
from litsim_sim.core.scene import STEP_S, AgentTable
from litsim_sim.scenario.setting import Setting

Build = Callable[..., AgentTable]
EGO, ROI = 1, 30.0
SETTING = cast(Setting, SimpleNamespace(ego_ids=EGO))
CONFIG = KinematicConfig()
HORIZON_STEPS = 25
FUTURE = CONFIG.dt * np.arange(1, HORIZON_STEPS + 1)
MILLIMETRE = 1e-3

speeds = st.floats(0.0, 40.0)
headings = st.floats(-3.1, 3.1)


def arc(agent: int, step: int, x: float, y: float, yaw: float, speed: float, rate: float) -> dict[str, Any]:
    """An agent that turns at `rate` about a fixed point since step 0, when it was at x, y."""
    t = step * STEP_S
    if abs(rate) < 1e-6:
        along, across = speed * t, 0.0
    else:
        along, across = speed / rate * np.sin(rate * t), speed / rate * (1.0 - np.cos(rate * t))
    cos, sin = np.cos(yaw), np.sin(yaw)
    heading = (yaw + rate * t + np.pi) % (2 * np.pi) - np.pi
    moved = {"x": x + cos * along - sin * across, "y": y + sin * along + cos * across, "yaw": heading}
    return {"id": agent, "speed": speed, **moved}


def kinematic(config: KinematicConfig = CONFIG) -> KinematicPredictor:
    """The predictor of all agents around the ego."""
    return KinematicPredictor(SETTING, Scope(ROI, Wanted.ALL), config)


def forecast(build: Build, *motions: tuple[Any, ...], steps: int = 11, config: KinematicConfig = CONFIG) -> Forecast:
    """The last forecast after `steps` steps of agents with these motions (id, x, y, yaw, speed, rate)."""
    predictor = kinematic(config)
    for step in range(steps):
        out = predictor.forecast(build(step, *(arc(m[0], step, *m[1:]) for m in motions)))
    return out


def assert_sane(out: Forecast, count: int) -> None:
    """Shapes, types, finite values, and a covariance that is one."""
    assert out.mean.shape == (count, HORIZON_STEPS, 2)
    assert out.yaw.shape == (count, HORIZON_STEPS)
    assert out.covariance.shape == (count, HORIZON_STEPS, 3)
    assert out.maneuver_probability.shape == (count, 0)
    assert out.valid.shape == out.id.shape == (count,)
    for array in (out.mean, out.yaw, out.covariance, out.maneuver_probability):
        assert array.dtype == (np.float64 if array is out.mean else np.float32)
        assert np.isfinite(array).all()
    sigma_x, sigma_y, rho = np.moveaxis(out.covariance.astype(np.float64), -1, 0)
    assert (sigma_x > 0).all()
    assert (sigma_y > 0).all()
    assert (np.abs(rho) < 1.0).all()


# Straight on


@given(speed=speeds, yaw=headings, x=st.floats(-500, 500), y=st.floats(-500, 500), steps=st.integers(1, 15))
def test_straight_motion_is_exact(agent_table: Build, speed: float, yaw: float, x: float, y: float, steps: int) -> None:
    out = forecast(agent_table, (EGO, x, y, yaw, speed, 0.0), steps=steps)
    assert (out.step, out.dt, out.id.tolist(), out.valid.tolist()) == (steps - 1, 0.2, [EGO], [True])
    gone = speed * ((steps - 1) * STEP_S + FUTURE)
    expected = np.column_stack([x + gone * np.cos(yaw), y + gone * np.sin(yaw)])
    np.testing.assert_allclose(out.mean[0], expected, atol=MILLIMETRE)
    np.testing.assert_allclose(out.yaw[0], yaw, atol=1e-6)
    assert_sane(out, 1)


def test_other_horizons_and_steps(agent_table: Build) -> None:
    config = replace(CONFIG, horizon=2.0, dt=0.1)
    out = forecast(agent_table, (EGO, 0.0, 0.0, 0.0, 10.0, 0.0), config=config)
    assert (out.dt, out.mean.shape) == (0.1, (1, 20, 2))
    np.testing.assert_allclose(out.mean[0, :, 0], 10.0 + np.arange(1, 21), atol=MILLIMETRE)


def test_a_horizon_without_a_step_is_refused() -> None:
    with pytest.raises(ValueError, match=r"dt is 0\.5, expected at most horizon, which is 0\.1"):
        KinematicConfig(horizon=0.1, dt=0.5)


# Turning


@given(speed=st.floats(1.0, 15.0), yaw=headings, rate=st.floats(0.05, 0.5), left=st.booleans())
def test_a_turn_is_an_arc_that_becomes_straight(
    agent_table: Build, speed: float, yaw: float, rate: float, left: bool
) -> None:
    signed = rate if left else -rate
    out = forecast(agent_table, (EGO, 3.0, -2.0, yaw, speed, signed))
    now = arc(EGO, 10, 3.0, -2.0, yaw, speed, signed)
    fine = 0.001 * np.arange(5000) + 0.0005
    heading = now["yaw"] + signed * RATE_DECAY * (1.0 - np.exp(-fine / RATE_DECAY))
    way = 0.001 * speed * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    at = np.round(FUTURE / 0.001).astype(int) - 1
    # The way is a polyline whose segments are as long as the arcs over them: off by (rate dt)^2 / 24 of the way; and
    # their headings are the means of those at their ends.
    curved = (rate * CONFIG.dt) ** 2 / 24.0 + rate / RATE_DECAY * CONFIG.dt**2 / 8.0
    slack = speed * FUTURE[-1] * curved + MILLIMETRE
    np.testing.assert_allclose(out.mean[0], np.array([now["x"], now["y"]]) + way[at], atol=slack)
    np.testing.assert_allclose(out.yaw[0], heading[at], atol=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_turn_rates_within_the_dead_band_are_none(agent_table: Build, sign: float) -> None:
    within = forecast(agent_table, (EGO, 0.0, 0.0, 0.0, 20.0, sign * 0.029))
    beyond = forecast(agent_table, (EGO, 0.0, 0.0, 0.0, 20.0, sign * 0.031))
    assert np.ptp(within.yaw[0]) == 0.0
    assert sign * (beyond.yaw[0, -1] - beyond.yaw[0, 0]) > 0.03


def test_the_turn_rate_is_the_mean_over_the_last_second(agent_table: Build) -> None:
    """A lane change that has ended a second ago is over; one half a second ago still counts for half."""
    predictor, half = kinematic(), None
    for step in range(40):
        turned = 0.2 * STEP_S * min(step, 15)
        out = predictor.forecast(agent_table(step, {"id": EGO, "yaw": turned}))
        half = out if step == 20 else half
    assert half is not None
    assert half.yaw[0, -1] - 0.3 == pytest.approx(0.1 * 1.5 * (1 - np.exp(-5.0 / 1.5)), abs=1e-5)
    assert np.ptp(out.yaw[0]) == 0.0


# History


@pytest.mark.parametrize(("steps", "known"), [(1, False), (2, False), (6, False), (7, True), (11, True), (30, True)])
def test_a_turn_is_known_after_more_than_half_a_second(agent_table: Build, steps: int, known: bool) -> None:
    out = forecast(agent_table, (EGO, 0.0, 0.0, 0.0, 10.0, 0.3), steps=steps)
    assert (np.ptp(out.yaw[0]) > 0.0) == known
    assert_sane(out, 1)


def test_a_gap_in_the_steps_forgets_the_turn(agent_table: Build) -> None:
    predictor = kinematic()
    for step in [*range(11), 12]:
        out = predictor.forecast(agent_table(step, arc(EGO, step, 0.0, 0.0, 0.0, 10.0, 0.3)))
    assert np.ptp(out.yaw[0]) == 0.0


def test_an_empty_road(agent_table: Build) -> None:
    predictor = kinematic()
    for step in range(3):
        out = predictor.forecast(AgentTable.empty(step))
        assert out.step == step
        assert_sane(out, 0)
    assert predictor.forecast(agent_table(3, {"id": EGO})).id.tolist() == [EGO]


# Agents do not depend on each other


motions = st.tuples(st.floats(-20, 20), st.floats(-20, 20), headings, speeds, st.floats(-0.4, 0.4))


@given(st.lists(motions, min_size=1, max_size=4), st.lists(motions, min_size=1, max_size=4))
def test_agents_outside_the_region_do_not_change_anything(
    agent_table: Build, near: list[tuple[float, ...]], far: list[tuple[float, ...]]
) -> None:
    ego = (EGO, 0.0, 0.0, 0.0, 0.0, 0.0)
    inside = [(10 * (i + 1), *m[:3], 0.5, m[4]) for i, m in enumerate(near)]
    outside = [(10 * (i + 1) + 5, m[0] + 300.0, *m[1:]) for i, m in enumerate(far)]
    alone, together = forecast(agent_table, ego, *inside), forecast(agent_table, ego, *inside, *outside)
    assert alone.id.tolist() == [EGO, *(m[0] for m in inside)]
    assert not len(alone.modes) and not len(together.modes)
    for field in fields(Forecast):
        if field.name == "modes":
            continue
        np.testing.assert_array_equal(getattr(alone, field.name), getattr(together, field.name), field.name)


def test_who_comes_into_the_region_is_known_from_outside(agent_table: Build) -> None:
    """The history holds everybody, so that a turn is not forgotten at the border."""
    predictor = kinematic()
    for step in range(11):
        x = 100.0 if step < 10 else 20.0
        out = predictor.forecast(agent_table(step, {"id": EGO}, {"id": 2, "x": x, "yaw": 0.3 * STEP_S * step}))
        assert out.id.tolist() == ([EGO] if step < 10 else [EGO, 2])
    assert np.ptp(out.yaw[1]) > 0.1


# Uncertainty


@given(headings, speeds)
def test_spread_grows_and_lies_along_the_heading(agent_table: Build, yaw: float, speed: float) -> None:
    out = forecast(agent_table, (EGO, 0.0, 0.0, yaw, speed, 0.0))
    sigma_x, sigma_y, rho = np.moveaxis(out.covariance[0].astype(np.float64), -1, 0)
    covariance = np.array([[sigma_x**2, rho * sigma_x * sigma_y], [rho * sigma_x * sigma_y, sigma_y**2]])
    values, vectors = np.linalg.eigh(np.moveaxis(covariance, -1, 0))
    along = 0.1 + 0.55 * FUTURE + 0.16 * FUTURE**2
    across = 0.1 + 0.15 * FUTURE + 0.02 * FUTURE**2
    np.testing.assert_allclose(np.sqrt(values), np.column_stack([across, along]), rtol=1e-4)
    alignment = np.abs(vectors[:, 0, 1] * np.cos(yaw) + vectors[:, 1, 1] * np.sin(yaw))
    np.testing.assert_allclose(alignment, 1.0, atol=1e-4)


# Forecast.rows


def test_rows_of_a_forecast_skip_the_absent_and_the_invalid(agent_table: Build) -> None:
    out = forecast(agent_table, *((i, 5.0 * i, 0.0, 0.0, 1.0, 0.0) for i in (1, 3, 5)))
    assert out.rows(np.array([5, 2, 1, 9, 0])).tolist() == [2, -1, 0, -1, -1]
    doubtful = replace(out, valid=np.array([True, False, True]))
    assert doubtful.rows(np.array([1, 3, 5])).tolist() == [0, -1, 2]
    nobody = kinematic().forecast(AgentTable.empty(0))
    assert nobody.rows(np.array([1, 2])).tolist() == [-1, -1]
