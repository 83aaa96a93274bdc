"""A queue in which boxes overlap in the log itself: vehicles of unknown size that were given the usual one."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.in_process import record
from litsim_sim.core.scene import STEP_S, AgentTable, EgoCommand
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

EGO, LENGTH, STANDS = 1, 4.5, 200.0
SPEED, BRAKES, STARTS = 10.0, 2.0, 1.5  # [m/s], [m/s2]
STEPS = 300


def waiting(agent: int, place: float, until_s: float) -> SimpleNamespace:
    """Comes at SPEED, stands at x = `place` from about 9 s on, and starts at `until_s`."""
    time = STEP_S * np.arange(STEPS + 1)
    brake_at = 4.0 + 0.3 * agent
    speed = np.where(time < brake_at, SPEED, np.maximum(0.0, SPEED - BRAKES * (time - brake_at)))
    speed = np.where(time < until_s, speed, np.minimum(SPEED, STARTS * (time - until_s)))
    x = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * STEP_S)])
    x += place - x[round((until_s - 1.0) / STEP_S)]
    same = {"y": -5.49, "yaw": 0.0, "length": LENGTH, "width": 2.0, "kind": 0, "lane": -1}
    moving = {"x": x, "speed": speed, "acceleration": np.gradient(speed, STEP_S)}
    table = pd.DataFrame({"vehicle_id": agent, "frame": np.arange(STEPS + 1), **moving, **same})
    return SimpleNamespace(id=agent, rows=lambda: table)


@pytest.fixture
def queue(make_scenario: Callable[..., Scenario]) -> Callable[[float], Scenario]:
    """The ego, one 2.5 m behind it, and three more, each `gap` [m] behind the one before: negative is an overlap."""

    def make(gap: float) -> Scenario:
        places = [STANDS, STANDS - LENGTH - 2.5]
        places += [places[1] - (k + 1) * (LENGTH + gap) for k in range(3)]
        tracks = [waiting(k + 1, place, 20.0 + 0.8 * k) for k, place in enumerate(places)]
        return make_scenario(*tracks, history_steps=10, simulation_s=28.0)

    return make


class Braking:
    """An ego that brakes from 2.5 s on for 1.5 s, for nothing, and then makes for its place in the log."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario

    def plan(self, table: AgentTable) -> EgoCommand:
        log = self._scenario.log.table(table.step)
        i, j = table.row(EGO), log.row(EGO)
        if i < 0 or 25 <= table.step < 40:
            return EgoCommand(table.step, -4.0)
        wanted = 0.8 * (log.x[j] - table.x[i]) + 1.8 * (log.speed[j] - table.speed[i]) + log.acceleration[j]
        return EgoCommand(table.step, float(np.clip(wanted, -3.0, 2.0)))


def test_an_overlap_of_the_log_holds_nobody_while_the_queue_stands(queue) -> None:
    """They had been held for 20 s and longer: each waited for the other to leave its place in the log.

    Nobody passes: who does has left the queue.
    """
    scenario = queue(-0.5)
    plan = RunPlan(scenario, "log", "yield", parameters={"conflict": {"passing": False}})
    metrics = compute_metrics(record(plan, ego=Braking(scenario)))
    early = [entry for entry in metrics["ledger"] if entry["detected_step"] < 200]
    assert {entry["agent"] for entry in early} == {2, 3, 4, 5}, "all of them have to brake"
    released = [entry["released_step"] for entry in early]
    assert None not in released and max(released) < 200, "before the queue moves again at 20 s"
    assert metrics["collision"]["pairs"] == metrics["collision"]["log_floor"] == 3
    assert metrics["collision"]["excess"] == 0, "no contact that the log has not"


def test_a_new_overlap_of_the_same_two_is_resolved(queue) -> None:
    """The ego stands 4 m before its place: who is behind it does not drive into it, whatever overlaps further back."""
    scenario = queue(-0.5)

    class Short(Braking):
        def plan(self, table: AgentTable) -> EgoCommand:
            row = table.row(EGO)
            stop = row >= 0 and table.x[row] + table.speed[row] ** 2 / (2 * BRAKES) >= STANDS - 4.0
            return EgoCommand(table.step, -BRAKES if stop and table.speed[row] > 0 else 0.0)

    metrics = compute_metrics(record(RunPlan(scenario, "log", "yield"), ego=Short(scenario)))
    assert {2, 3, 4, 5} <= {entry["agent"] for entry in metrics["ledger"]}
    assert metrics["collision"]["excess"] == 0
