"""Whole runs of real traffic: whoever is off its log, or on the way onto or off it, moves as a vehicle can.

The recording itself does not: NGSIM's positions jitter beyond any vehicle's limits. Steps from log to log before the
first takeover are therefore left out, and after a release the log's own jitter at that moment is what is allowed.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.takeover import jump
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.scene import STEP_S, AgentTable, Controller
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.scenario.scenario import Scenario

BETWEEN = 0.02  # [m] by which a step may differ from the mean velocity: acceleration need not be constant within it
FADE_POSITION, FADE_SPEED = 0.08, 0.16  # [m], [m/s] that a fading residual adds in a step: 1.5 m/s2, and the heading's

EVERYBODY = (Controller.LOG, Controller.POLICY, Controller.EGO)

pytestmark = pytest.mark.data


@pytest.fixture(scope="module")
def real(real_data) -> Scenario:
    real_data()
    return Scenario.load("us101_0750")


def steps_since_taken(run: Any, agent: int) -> Iterator[tuple[AgentTable, AgentTable, int]]:
    """Tables before and after each step of `agent` from its first takeover on, and the lag of its log [steps] then."""
    records, lag = run.takeovers(agent), 0
    for before, after in pairwise(r.table for r in run.results[min(records) :]):
        if before.step in records and records[before.step].state == TakeoverState.RELEASED:
            lag = round(records[before.step].time_shift / STEP_S)
        if before.row(agent) >= 0 and after.row(agent) >= 0:
            yield before, after, lag


def swing(before: AgentTable, after: AgentTable, agent: int) -> float:
    """How far the centre of a box swings out in a step, for it lies ahead of the rear axle [m]."""
    i, j = before.row(agent), after.row(agent)
    return float(VehicleLimits().rear_axle * before.length[i] * abs(np.sin(after.yaw[j] - before.yaw[i])))


@pytest.mark.parametrize("policy", ["yield", "litsim"])
@pytest.mark.parametrize(("position", "ego"), [(2, "perturbed"), (5, "idm")])
def test_real_agents_neither_jump_nor_exceed_limits_however_they_change_hands(
    real: Scenario, drive, beyond_limits, policy: str, position: int, ego: str
) -> None:
    scenario = Scenario.load("us101_0750", ego=real.tuning_egos[position])
    run = drive(scenario, ego, policy=policy, parameters={"predictor": {"model": "kinematic"}})
    seen: Counter[tuple[Controller, Controller]] = Counter()
    back: set[tuple[int, int]] = set()  # steps and agents, of steps that end on the log
    for agent in sorted({t.agent for r in run.results for t in r.takeovers.takeovers}):
        for before, after, lag in steps_since_taken(run, agent):
            hands = (Controller(before.controller[before.row(agent)]), Controller(after.controller[after.row(agent)]))
            seen[hands] += 1
            found, where = jump(before, after, agent, STEP_S), (agent, before.step, hands)
            if hands[1] == Controller.POLICY:
                assert found.position <= BETWEEN + swing(before, after, agent), where
                assert (found.speed, found.yaw) == pytest.approx((0.0, 0.0), abs=1e-6), where
                continue
            back.add((before.step, agent))
            log = jump(scenario.log.table(before.step - lag), scenario.log.table(after.step - lag), agent, STEP_S)
            assert found.position <= log.position + FADE_POSITION, where
            assert found.speed <= log.speed + FADE_SPEED, where
    assert seen[Controller.LOG, Controller.POLICY] >= 1 and seen[Controller.POLICY, Controller.POLICY] > 5
    # whether policy C brings anybody back depends on its weights
    assert policy != "yield" or seen[Controller.POLICY, Controller.LOG] >= 1, "somebody goes back"
    beyond = set(beyond_limits(run.results, EVERYBODY)) - set(beyond_limits(run.results, (Controller.LOG,)))
    # the ego may follow its log as EGO, jitter and all
    assert {(step, agent) for step, agent, _ in beyond if agent != scenario.ego_id} <= back
