"""The forecast that comes true: what happened, from where agents are now."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_predictor.plugin import Scope
from litsim_predictor.selection import Wanted
from litsim_research.oracle import Oracle, OracleConfig
from litsim_sim.scenario.outcomes import RecordedOutcomes, file_of


@pytest.fixture
def oracle(make_scenario: Callable[..., Any], track: Any, tmp_path: Path) -> Oracle:
    """The ego 1 brakes from 10 m/s after step 5; 2 leaves the road after step 8."""
    pose, there = np.zeros((2, 100, 3)), np.ones((2, 100), np.bool_)
    pose[0, :, 0] = np.minimum(np.arange(100.0), 5.0)
    pose[1, :, 0], pose[1, :, 1] = 20.0 + 2.0 * np.arange(100), 3.5
    there[1, 9:] = False
    scenario = make_scenario(track(1, x=100.0), track(2, x=120.0), history_steps=3)
    RecordedOutcomes(pose, there, np.empty((0, 3), np.int64)).write(file_of(tmp_path, scenario))
    return Oracle(scenario, Scope(30.0, Wanted.ALL), OracleConfig(str(tmp_path)))


def test_agents_go_on_as_they_did(oracle: Oracle, agent_table: Callable[..., Any]) -> None:
    ego, other = {"id": 1, "x": 3.0, "y": 0.0}, {"id": 2, "x": 26.0, "y": 3.5}
    forecast = oracle.forecast(agent_table(3, ego, other))
    assert forecast.id.tolist() == [1, 2] and forecast.valid.all() and forecast.dt == pytest.approx(0.1)
    assert forecast.mean[0, :4, 0].tolist() == [4.0, 5.0, 5.0, 5.0]
    assert forecast.mean[1, :7, 0].tolist() == [28.0, 30.0, 32.0, 34.0, 36.0, 38.0, 40.0], (
        "beyond, at its last velocity"
    )
    assert (forecast.covariance[..., :2] < 0.1).all()


def test_from_where_they_are_now(oracle: Oracle, agent_table: Callable[..., Any]) -> None:
    forecast = oracle.forecast(agent_table(3, {"id": 1, "x": 1.0, "y": 0.5}))
    assert forecast.mean[0, :3].tolist() == [[2.0, 0.5], [3.0, 0.5], [3.0, 0.5]]


def test_who_was_gone_by_then_has_no_forecast(oracle: Oracle, agent_table: Callable[..., Any]) -> None:
    forecast = oracle.forecast(agent_table(20, {"id": 1, "x": 5.0, "y": 0.0}, {"id": 2, "x": 20.0, "y": 3.5}))
    assert forecast.valid.tolist() == [True, False]
    assert forecast.rows(np.array([1, 2])).tolist() == [0, -1]


def test_who_was_never_there_has_no_forecast(oracle: Oracle, agent_table: Callable[..., Any]) -> None:
    forecast = oracle.forecast(agent_table(3, {"id": 0, "x": 4.0, "y": 0.0}, {"id": 1, "x": 3.0}, {"id": 9, "x": 5.0}))
    assert forecast.valid.tolist() == [False, True, False]
