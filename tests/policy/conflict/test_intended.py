"""Agents under control go on along their paths, as their policies have begun."""

from __future__ import annotations

import numpy as np
import pytest
from litsim_policy.conflict.intended import IntentConfig, Intents, intended_motion

from litsim_policy.conflict.futures import PredictedMotion
from litsim_policy.motion.path_batch import PathBatch

STEPS = 30
STRAIGHT = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
CORNER = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 100.0]])
TIME = 0.1 * np.arange(1, STEPS + 1)


def go_on(agent_table, path: np.ndarray, *, forecast: float | None = None, fresh: bool = False, **agent: float):
    """Motion of agent 7, which is on `path`, where the forecast has it at a speed [m/s], or knows nothing of it."""
    table = agent_table(3, {"id": 2, "x": 50.0}, {"id": 7, **agent})
    states, valid = np.zeros((1, STEPS, 6)), np.full((1, STEPS), forecast is not None)
    states[0, :, 0], states[0, :, 1] = table.x[1] + (forecast or 0.0) * TIME, table.y[1]
    intents = Intents(np.array([1]), PathBatch([path]), np.array([fresh]))
    return intended_motion(IntentConfig(), intents, table, PredictedMotion(states, valid), 1.0)


def test_it_keeps_its_braking_for_a_while_and_comes_to_its_path(agent_table) -> None:
    found = go_on(agent_table, STRAIGHT, x=10.0, y=2.0, speed=10.0, acceleration=-4.0)
    gone = np.where(TIME <= 1.0, 10.0 * TIME - 2.0 * TIME**2, 8.0 + 6.0 * (TIME - 1.0))
    np.testing.assert_allclose(found.x[0], 10.0 + gone, atol=1e-9)
    np.testing.assert_allclose(found.y[0], 2.0 * np.exp(-TIME), atol=1e-9)
    assert found.valid.all() and not len(found.others)
    along, across = found.covariance[0, -1, 0], found.covariance[0, -1, 1]
    assert along > 25.0 * across > 0.0, "where to is known better than how fast"


def test_who_has_stopped_does_not_reverse(agent_table) -> None:
    found = go_on(agent_table, STRAIGHT, x=10.0, speed=2.0, acceleration=-4.0)
    assert found.x[0, -1] == pytest.approx(10.5) and (np.diff(found.x[0]) >= 0.0).all()


def test_it_takes_the_turn_that_its_path_takes_whatever_the_forecast_says(agent_table) -> None:
    found = go_on(agent_table, CORNER, x=10.0, speed=10.0, forecast=10.0)
    assert (found.x[0, -1], found.y[0, -1]) == pytest.approx((20.0, 20.0))
    assert found.yaw[0, -1] == pytest.approx(np.pi / 2)
    assert found.covariance[0, -1, 1] > found.covariance[0, -1, 0], "the spread turns with the path"


def test_how_far_it_gets_is_first_its_own_and_later_the_forecast_s(agent_table) -> None:
    found = go_on(agent_table, STRAIGHT, x=10.0, speed=10.0, forecast=4.0)
    assert found.x[0, 9] == pytest.approx(20.0), "after 1 s as it drives now"
    assert found.x[0, 19] == pytest.approx(10.0 + 0.5 * (20.0 + 8.0)), "after 2 s half of both"
    assert found.x[0, 29] == pytest.approx(10.0 + 12.0), "after 3 s as it is forecast"


def test_whose_policy_has_done_nothing_yet_gets_as_far_as_it_is_forecast(agent_table) -> None:
    found = go_on(agent_table, CORNER, x=10.0, speed=10.0, forecast=5.0, fresh=True)
    assert found.x[0, 9] == pytest.approx(15.0) and found.y[0, 29] == pytest.approx(5.0)


def test_intents_follow_their_agents_into_a_part_of_the_table() -> None:
    intents = Intents(np.array([2, 5, 8]), PathBatch([STRAIGHT, CORNER, STRAIGHT]), np.array([False, True, False]))
    some = intents.among(np.isin(np.arange(10), [1, 5, 8, 9])).moved_to(np.array([1, 5, 8, 9]))
    assert some.rows.tolist() == [1, 2] and some.fresh.tolist() == [True, False]
    np.testing.assert_array_equal(some.paths.point(np.array([30.0, 30.0])), [[20.0, 10.0], [30.0, 0.0]])
