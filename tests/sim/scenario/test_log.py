"""Steps of a log as tables, with and without lags, against looking up every agent."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_sim.core.scene import Controller
from litsim_sim.scenario.log import Log


@pytest.fixture(scope="module")
def log() -> Log:
    """Nine agents that come and go within thirty steps, every number another."""
    random = np.random.default_rng(0)
    first = random.integers(0, 15, 9)
    last = first + random.integers(0, 15, 9)
    valid = (np.arange(30) >= first[:, None]) & (np.arange(30) <= last[:, None])
    columns = random.normal(size=(6, 9, 30)) * valid
    sizes = random.uniform(2.0, 6.0, (2, 9))
    return Log(np.arange(9) * 3 + 5, np.arange(9, dtype=np.uint8), *sizes, first, last, valid, *columns)


@pytest.mark.parametrize("lagged", [False, True])
@pytest.mark.parametrize("step", range(-2, 34, 3))
def test_a_step_holds_whom_the_log_has_on_the_road_then(log: Log, step: int, lagged: bool) -> None:
    lag = np.random.default_rng(step + 2).integers(0, 12, 9) if lagged else np.zeros(9, np.int64)
    table = log.table(step, lag if lagged else None)
    there = [k for k in range(9) if 0 <= step - lag[k] < 30 and log.valid[k, step - lag[k]]]
    assert table.step == step and table.id.tolist() == [int(log.ids[k]) for k in there]
    assert (table.controller == Controller.LOG).all()
    for field in ("kind", "length", "width"):
        assert getattr(table, field).tolist() == [getattr(log, field)[k] for k in there]
    for field in ("x", "y", "yaw", "speed", "acceleration", "yaw_rate"):
        assert getattr(table, field).tolist() == [getattr(log, field)[k, step - lag[k]] for k in there]


def test_tables_are_copies(log: Log) -> None:
    before = log.x.copy()
    log.table(10).x[:] = 0.0
    assert (log.x == before).all()
