"""The loop by itself: its runs are those that are recorded in process, alone and together."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.identity import digest
from litsim_eval.runs.in_process import record
from litsim_policy.driving.yield_policy import YieldPolicy
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand, EgoMode
from litsim_sim.core.stages import BRIDGE, EGO
from litsim_sim.record.digest import RunDigest
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation, Step

Made = Callable[..., Any]


@pytest.fixture(scope="module")
def demo() -> Scenario:
    return Scenario.load("demo", simulation_s=5.0)


@pytest.fixture
def braking(make_scenario: Made, track: Made) -> Scenario:
    """Two vehicles, the ego ahead; 2 s."""
    return make_scenario(track(1, x=100.0, speed=8.0, last=20), track(2, x=80.0, speed=8.0, last=20))


def driven(simulation: Simulation) -> str:
    """Steps `simulation` to its end; returns the digest of what its observers see."""
    run = RunDigest()
    simulation.observers.append(lambda step: run.update(step.table, step.controls, step.ego))
    while not simulation.ended:
        simulation.step()
    simulation.observers.pop()
    return run.hexdigest()


def apart(simulation: Simulation, step: Step) -> tuple[AgentTable, ControlTable | None, EgoCommand]:
    """Returns what a digest reads of the first of several scenarios."""
    own = simulation.apart(step)[0]
    return own.table, own.controls, own.ego


@pytest.mark.parametrize(
    ("ego", "policy"), [("idm", "litsim"), ("perturbed", "yield"), ("log", "replay"), ("bat", "litsim")]
)
def test_a_run_is_the_recorded_one_and_the_same_once_more(demo: Scenario, ego: str, policy: str) -> None:
    simulation, expected = Simulation(demo, ego, policy), digest(record(RunPlan(demo, ego, policy)))
    assert driven(simulation) == expected
    assert simulation.reset().step == 0 and not simulation.ended
    assert driven(simulation) == expected


@pytest.mark.parametrize("latency", ["0", "0.4"])
def test_several_scenarios_together_are_each_what_they_are_alone(demo: Scenario, latency: str) -> None:
    scenarios, egos = [demo, demo.around(demo.egos[1], 3)], ["idm", "perturbed"]
    later = {BRIDGE: {"latency": latency}}
    together = Simulation(scenarios, egos, "yield", later)
    digests = [RunDigest() for _ in scenarios]
    for step in together.steps():
        for number, own in together.apart(step).items():
            digests[number].update(own.table, own.controls, own.ego)
    alone = [driven(Simulation(*given, "yield", later)) for given in zip(scenarios, egos, strict=True)]
    assert [each.hexdigest() for each in digests] == alone
    assert set(together.summaries) == {0, 1}


def test_the_caller_may_answer_in_place_of_ego_and_policy(demo: Scenario) -> None:
    simulation, seen = Simulation(demo, policy=None), RunDigest()
    simulation.observers.append(lambda step: seen.update(step.table, step.controls, step.ego))
    for step in Simulation(demo, "idm").steps():
        simulation.step(step.ego, step.controls)
    assert seen.hexdigest() == driven(Simulation(demo, "idm"))


def test_the_caller_may_drive_agents_that_are_taken_over(demo: Scenario) -> None:
    def act(simulation: Simulation) -> ControlTable:
        assert simulation.takeovers is not None
        return policy.act(simulation.table, simulation.takeovers)

    simulation, policy, seen = Simulation(demo, "idm", "litsim"), YieldPolicy(demo), RunDigest()
    simulation.observers.append(lambda step: seen.update(step.table, step.controls, step.ego))
    while not simulation.ended:
        simulation.step(controls=act(simulation))
    assert simulation.table.of_policy.any()
    assert seen.hexdigest() == driven(Simulation(demo, "idm", "yield"))


def test_without_a_policy_nobody_is_off_the_log_but_whom_the_caller_drives(braking: Scenario) -> None:
    simulation = Simulation(braking, "log", policy=None)
    assert simulation.takeovers is None
    while not simulation.ended:
        controls, row = ControlTable.empty(simulation.table.step), simulation.table.rows(np.array([2]))
        if simulation.table.step >= braking.history_steps:
            controls = ControlTable.of_policy(simulation.table, row, np.array([-1.0]), np.zeros(1))
        table = simulation.step(controls=controls)
    assert table.of_policy.tolist() == [False, True] and table.speed[1] < 7.0


def test_a_scenario_that_is_ended_leaves_the_other_as_it_is_alone(demo: Scenario) -> None:
    together, seen = Simulation([demo, demo.around(demo.egos[1], 3)], "idm", "yield"), RunDigest()
    together.observers.append(lambda step: seen.update(*apart(together, step)))
    while not together.ended:
        if together.step().step == 40:
            assert together.takeovers is not None and together.takeovers.takeovers
            together.end(1)
            assert set(together.table.scene.tolist()) == {0} == set(together.running)
    assert together.summaries[1]["ended"] == {"reason": "time", "step": 40, "lane": ""}
    assert seen.hexdigest() == driven(Simulation(demo, "idm", "yield"))


def test_runs_of_full_length_go_on_once_the_ego_has_left(make_scenario: Made, track: Made) -> None:
    scenario = make_scenario(track(1, x=620.0, speed=20.0, last=4), track(2, x=100.0, last=20))
    for full_length, last in ((False, 5), (True, scenario.total_steps)):
        simulation = Simulation(scenario, "log", "replay", full_length=full_length)
        assert [step.table.step for step in simulation.steps()][-1] == last


def test_the_ego_of_one_scenario_in_a_list_is_not_told_of_hidden_agents(make_scenario: Made, track: Made) -> None:
    changes = [{"kind": "hide", "agent": 2, "begin_s": 0.3, "duration_s": 1.0}]
    scenario = make_scenario(track(1, x=80.0), track(2, x=100.0, speed=5.0), changes=changes)
    told: list[list[int]] = []
    ego = SimpleNamespace(plan=lambda table: told.append(table.id.tolist()) or EgoCommand(table.step))
    simulation = Simulation([scenario], ego, "replay")
    for _ in range(4):
        simulation.step()
    assert simulation.batch is not None and told == [[1, 2], [1, 2], [1, 2], [1]]


def test_a_class_of_policies_may_stand_for_a_name(demo: Scenario) -> None:
    assert driven(Simulation(demo, "idm", YieldPolicy)) == driven(Simulation(demo, "idm", "yield"))


def test_a_policy_for_one_scenario_is_refused_for_several(braking: Scenario) -> None:
    alone = type("Alone", (YieldPolicy,), {"batched": False})
    with pytest.raises(ValueError, match="drives the agents of one scenario"):
        Simulation([braking, braking.around(2, None)], "log", alone)


def test_observers_see_each_step_before_the_next_one_is_there(braking: Scenario) -> None:
    seen: list[tuple[int, int]] = []
    simulation = Simulation(braking, "log", "replay")
    simulation.observers.append(lambda step: seen.append((step.table.step, simulation.table.step)))
    steps = list(simulation.steps())
    assert seen == [(step, step) for step in range(braking.total_steps + 1)]
    assert all(set(step.stage_s) == {BRIDGE, EGO} and step.running == (0,) for step in steps)


def test_the_log_is_followed_where_the_caller_says_so(braking: Scenario) -> None:
    simulation = Simulation(braking, policy="replay")
    while not simulation.ended:
        table = simulation.step(EgoCommand(simulation.table.step, mode=EgoMode.FOLLOW_LOG))
    assert table.x.tolist() == braking.log.table(braking.total_steps).x.tolist()
    assert simulation.summaries[0]["ended"]["reason"] == "time"


@pytest.mark.parametrize(
    ("ego", "commands", "expected"),
    [(None, None, "0 commands of egos were given, expected 1"), ("idm", [EgoCommand(0)], "1 commands .* expected 0")],
)
def test_commands_of_egos_are_given_where_none_is_named(
    braking: Scenario, ego: str | None, commands: Sequence[EgoCommand] | None, expected: str
) -> None:
    with pytest.raises(ValueError, match=expected):
        Simulation(braking, ego, "replay").step(commands)


def test_after_the_end_there_is_no_step(braking: Scenario) -> None:
    simulation = Simulation(braking, "log", "replay")
    driven(simulation)
    with pytest.raises(ValueError, match="has ended"):
        simulation.step()


def test_commands_of_drivers_count_later_by_the_latency(braking: Scenario) -> None:
    class Braking:
        def plan(self, table: AgentTable) -> EgoCommand:
            return EgoCommand(table.step, -0.1 * table.step)

    def commands(latency: str, clock: Callable[[], float] = lambda: 0.0) -> list[float]:
        simulation = Simulation(braking, Braking(), None, {BRIDGE: {"latency": latency}}, clock=clock)
        return [round(-10.0 * step.ego.acceleration) for step in simulation.steps()]

    last = braking.total_steps
    assert commands("0") == [*range(last + 1)]
    assert commands("0.3") == [0, 0, 0, *range(last - 2)]
    ticks = iter(0.06 * k for k in range(10**6))  # every look at the clock
    assert commands("measured", lambda: next(ticks)) == [0, *range(last)]
    with pytest.raises(InputError, match=r"bridge\.latency is 0\.25, expected measured, or a multiple"):
        Simulation(braking, "idm", "litsim", {BRIDGE: {"latency": 0.25}})


def test_what_cannot_be_run_is_refused(braking: Scenario) -> None:
    with pytest.raises(InputError, match="nobody"):
        Simulation(braking, "nobody")
    with pytest.raises(InputError, match=r"policy litsimm \(near: litsim\); expected .*replay"):
        Simulation(braking, "idm", "litsimm")
    with pytest.raises(ValueError, match="3 egos for 1 scenarios"):
        Simulation(braking, ["idm", "idm", "log"])


def test_a_step_of_several_has_no_single_ego(braking: Scenario) -> None:
    (first, *_) = Simulation([braking, braking.around(2, None)], "log", "replay").steps()
    assert isinstance(first, Step) and len(first.egos) == 2
    with pytest.raises(ValueError, match="unpack"):
        _ = first.ego
