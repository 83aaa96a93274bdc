"""Agents under control whose logs are over: they go once nobody needs them, and the ledger says so."""

from typing import Any

import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.in_process import record
from litsim_sim.core.scene import AgentTable, Controller, EgoCommand
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

EGO, BEHIND = 1, 2
LOG_OVER = 60


class Driver:
    """An ego that brakes from 10 to 6 m/s, and from `since` on drives at the acceleration `then`, up to 30 m/s."""

    def __init__(self, scenario: Scenario, since: int, then: float) -> None:
        self._ego, self._since, self._then = scenario.ego_id, since, then

    def plan(self, table: AgentTable) -> EgoCommand:
        row = table.row(self._ego)
        speed = 0.0 if row < 0 else table.speed[row]
        wanted = -4.0 if 5 <= table.step < 15 else 0.0 if table.step < self._since else self._then
        return EgoCommand(table.step, wanted if speed < 30.0 else 0.0)


@pytest.fixture(scope="module")
def scenario(make_scenario: Any, track: Any) -> Scenario:
    """BEHIND follows the ego closely; the recording loses sight of it, in the midst of the road, after 6 s."""
    return make_scenario(track(EGO, x=110.0, last=250), track(BEHIND, x=100.0, last=LOG_OVER))


def ledger_of(scenario: Scenario, since: int, then: float, handback: str) -> tuple[Any, dict[str, Any]]:
    plan = RunPlan(scenario, "log", "yield", {"conflict": {"handback": handback, "passing": False}})
    run = record(plan, ego=Driver(scenario, since, then))
    (entry,) = compute_metrics(run)["ledger"]
    assert entry["agent"] == BEHIND
    return run, entry


@pytest.mark.parametrize("handback", ["time_shift", "catch_up"])
def test_it_goes_when_the_ego_has_driven_away(scenario: Scenario, handback: str) -> None:
    run, entry = ledger_of(scenario, 150, 4.0, handback)
    released = entry["released_step"]
    assert released is not None and released > 150
    assert entry["outcome"] == "log_over"
    last, gone = run.tables[released], run.tables[released + 1]
    assert last.controller[last.row(BEHIND)] == Controller.POLICY
    assert gone.row(BEHIND) < 0
    away = last.x[last.row(EGO)] - last.x[last.row(BEHIND)]
    assert away > scenario.roi_m


def test_it_stays_as_long_as_the_ego_is_near(scenario: Scenario) -> None:
    """It follows the ego, and stands behind it, when its log is long over."""
    run, entry = ledger_of(scenario, 150, -1.0, "time_shift")
    assert (entry["released_step"], entry["outcome"]) == (None, "outlived_log")
    assert run.tables[-1].row(BEHIND) >= 0


def test_who_is_still_off_a_log_that_goes_on_is_told_apart(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(track(EGO, x=110.0, last=250), track(BEHIND, x=100.0, last=250))
    _, entry = ledger_of(scenario, 150, -1.0, "time_shift")
    assert (entry["released_step"], entry["outcome"]) == (None, None)
