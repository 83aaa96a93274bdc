"""Conflicts by hindsight: those of the log with what happened, and no others, once they are within the horizon."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.futures import Futures
from litsim_policy.conflict.hindsight import Hindsight
from litsim_predictor.forecast import Forecast
from litsim_sim.scenario.outcomes import RecordedOutcomes, file_of
from litsim_sim.scenario.scenario import Scenario


@pytest.fixture
def scenario(make_scenario: Callable[..., Scenario], track: Any, tmp_path: Path) -> Scenario:
    """The log of 2 met the ego at step 40 and later, that of 3 met 2 at step 45."""
    made = make_scenario(track(1, x=200.0), track(2, x=172.0), track(3, x=100.0), history_steps=3, roi_m=30.0)
    agents, steps = len(made.log.ids), made.total_steps + 1
    meetings = np.array([[1, 41, 0], [1, 40, 0], [2, 45, 1]])
    happened = RecordedOutcomes(np.zeros((agents, steps, 3)), np.ones((agents, steps), np.bool_), meetings)
    happened.write(file_of(tmp_path, made))
    return made


def conflicts_at(scenario: Scenario, folder: Path, step: int, on_log: list[bool]) -> list[Conflict]:
    table = scenario.log.table(step)
    futures = Futures(scenario.log, ConflictConfig(), table, Forecast.empty(step))
    return Hindsight(scenario, folder, 3.0).conflicts(futures, np.array(on_log), ~np.array(on_log))


@pytest.mark.parametrize(("step", "found"), [(9, []), (10, [(2, 1, 3.0)]), (38, [(2, 1, 0.2), (3, 2, 0.7)]), (45, [])])
def test_a_meeting_is_known_within_the_horizon(
    scenario: Scenario, tmp_path: Path, step: int, found: list[tuple[int, int, float]]
) -> None:
    conflicts = conflicts_at(scenario, tmp_path, step, [False, True, True])
    assert [(c.agent, c.opponent, pytest.approx(c.time_to_conflict)) for c in conflicts] == found
    for conflict in conflicts:
        row, at = scenario.log.row(conflict.agent), step + round(conflict.time_to_conflict / 0.1)
        assert conflict.pose[0] == scenario.log.x[row, at]


def test_who_is_off_his_log_already_is_in_no_new_conflict(scenario: Scenario, tmp_path: Path) -> None:
    conflicts = conflicts_at(scenario, tmp_path, 38, [False, False, True])
    assert [c.agent for c in conflicts] == [3]
