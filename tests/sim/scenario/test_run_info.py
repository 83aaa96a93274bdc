"""What is being run: its stages, and the name under which it goes."""

from dataclasses import replace

import pytest

from litsim_sim.scenario.policies import setup_of
from litsim_sim.scenario.run_info import RunPlan, new_execution
from litsim_sim.scenario.scenario import Scenario


@pytest.fixture(scope="module")
def plan() -> RunPlan:
    return RunPlan.load("demo", "idm", "litsim")


def test_equal_runs_have_equal_identities_however_they_are_written(plan: RunPlan) -> None:
    assert RunPlan.load("demo", "idm", "litsim").identity == plan.identity
    assert replace(plan, parameters={"conflict": {}}).identity == plan.identity
    two = [RunPlan.load("demo", "idm", "litsim", settings=[("conflict", "horizon", v)]).identity for v in (2, 2.0)]
    assert two[0] == two[1] != plan.identity
    parameters = [{"ego": {"time": value}, "policy": {"a": True}} for value in ((0.0, 1.0), [0, 1])]
    first, second = (replace(plan, parameters=each) for each in parameters)
    assert first.identity == second.identity
    later = {replace(plan, parameters={"bridge": {"latency": text}}).identity for text in ("0.1", "0.10", 0.1)}
    assert len(later) == 1 and plan.identity not in later


def test_whatever_changes_a_run_changes_its_identity(plan: RunPlan) -> None:
    others = [
        RunPlan.load("demo", "log", "litsim"),
        RunPlan.load("demo", "idm", "yield"),
        RunPlan.load("demo", "idm", "litsim", seed=99),
        RunPlan.load("demo", "idm", "litsim", vehicle={"lag_s": 0.3}),
        RunPlan.load("demo", "idm", "litsim", predictor="kinematic"),
        RunPlan.load("demo", "idm", "litsim", settings=[("conflict", "horizon", 2.0)]),
        RunPlan.load("demo", "idm", "litsim", settings=[("conflict", "horizon", 3.0)]),
        RunPlan.load("demo", "idm", "litsim", settings=[("policy", "horizon", 2.0)]),
    ]
    assert len({each.identity for each in (plan, *others)}) == len(others) + 1


def test_a_setup_is_its_policy_with_parameters_over_which_the_given_ones_go() -> None:
    plan = RunPlan.load("demo", "idm", "paper", settings=[("conflict", "horizon", 3.0)])
    own = setup_of("paper").stage_parameters()
    assert own["conflict"]["horizon"] == 5.0
    assert plan.policy == "litsim"
    assert plan.parameters == own | {"conflict": own["conflict"] | {"horizon": 3.0}}
    assert RunPlan.load("demo", "idm", "paper", predictor="kinematic").parameters["predictor"]["model"] == "kinematic"


def test_how_it_is_carried_out_does_not(plan: RunPlan) -> None:
    patient = RunPlan.load("demo", "idm", "litsim", settings=[("bridge", "answer_timeout_s", 60.0)])
    assert patient.identity == plan.identity
    scenario = Scenario.load("demo", coverage_min=0.5)
    assert replace(plan, scenario=scenario).identity == plan.identity, "what loading demands changes no run"
    replays = [RunPlan.load("demo", "idm", "replay", predictor=model).identity for model in ("kinematic", None)]
    assert replays[0] == replays[1], "nothing is forecast in a replay"


def test_no_two_executions_go_by_the_same_name(plan: RunPlan) -> None:
    assert plan.run_id == plan.identity == plan.facts()["run_id"], "in process nobody else can be heard"
    ids = {replace(plan, execution=new_execution()).run_id for _ in range(100)}
    assert len(ids) == 100 and all(each.startswith(f"{plan.identity}@") for each in ids)
