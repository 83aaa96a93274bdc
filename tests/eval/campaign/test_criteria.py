"""Limits on measures: what passes, what fails and why, and what is refused before anything is run."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from litsim_eval.analysis.metrics import find_field, leaves
from litsim_eval.campaign.criteria import CaseOutcome, Criteria, Criterion, SuiteCriterion, Verdict
from litsim_sim.core.errors import InputError

PASSED, FAILED, ERROR = (
    CaseOutcome(Verdict.PASSED, {"progress_m": 10.0, "reactive": True}),
    CaseOutcome(Verdict.FAILED, {"progress_m": 20.0, "reactive": False}),
    CaseOutcome(Verdict.ERROR, None),
)
UNFINISHED = CaseOutcome(None, None)


@pytest.mark.parametrize(
    ("limits", "good", "bad", "said"),
    [
        ({"field": "takeovers", "max": 2}, 2, 3, "takeovers is 3, expected at most 2"),
        ({"field": "progress_m", "min": 1.5}, 1.5, 1.4, "progress_m is 1.4, expected at least 1.5"),
        ({"field": "takeovers", "min": 1, "max": 2}, 1, 0, "takeovers is 0, expected at least 1 and at most 2"),
        ({"field": "reactive", "equals": True}, True, False, "reactive is false, expected true"),
        (
            {"field": "policy", "one_of": ["litsim", "yield"]},
            "yield",
            "replay",
            "policy is replay, expected one of litsim",
        ),
        ({"field": "seed", "one_of": [1, 2]}, 2, 3, "seed is 3, expected one of 1, 2"),
        ({"field": "ledger", "max": 1}, [{}], [{}, {}], "ledger is 2, expected at most 1"),
    ],
)
def test_a_limit_is_kept_or_not(limits: dict[str, Any], good: Any, bad: Any, said: str) -> None:
    criterion, field = Criterion(**limits), limits["field"]
    kept = criterion.of_run({field: good})
    assert kept.passed and kept.reason == ""
    broken = criterion.of_run({field: bad})
    assert not broken.passed and broken.reason.startswith(said)


@pytest.mark.parametrize("metrics", [{}, {"safety": {}}, {"safety": {"min_ttc_s": None}}, {"safety": None}])
def test_what_is_missing_fails_unless_it_is_said_to_pass(metrics: dict[str, Any]) -> None:
    limits = {"field": "safety.min_ttc_s", "min": 1.0}
    found = Criterion(**limits).of_run(metrics)
    assert (found.passed, found.value, found.reason) == (False, None, "safety.min_ttc_s is missing")
    assert Criterion(**limits, when_missing="pass").of_run(metrics).passed
    assert not Criterion(**limits, when_missing="pass").of_run({"safety": {"min_ttc_s": 0.9}}).passed


def test_keys_with_dots_are_found() -> None:
    assert leaves({"safety": {"ttc_below": {"0.95": 0.25}}})["safety.ttc_below.0.95"] == 0.25
    assert leaves({"lockstep": {"missed_by_topic": {"/a.b": 1}}})["lockstep.missed_by_topic./a.b"] == 1


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"field": "collision.ego_fault", "max": 0}, r"no field collision\.ego_fault .*near: collision\.ego_at_fault"),
        ({"field": "takeovers"}, "no limit, expected min, max, equals or one_of"),
        ({"field": "takeovers", "max": 1, "equals": 1}, "max and equals, expected one of them"),
        ({"field": "takeovers", "min": 2, "max": 1}, "min is 2, expected at most max, 1"),
        ({"field": "takeovers", "max": float("nan")}, "finite"),
        ({"field": "takeovers", "equals": "two"}, "field takeovers never is two, expected a number"),
        ({"field": "takeovers", "equals": True}, "field takeovers never is true, expected a number"),
        ({"field": "reactive", "equals": 1}, "field reactive never is 1, expected true or false"),
        ({"field": "valid", "min": 1}, "field valid: min of what is no number, expected equals or one_of"),
        ({"field": "policy", "one_of": ["litsim", 3]}, "field policy never is 3, expected a text"),
        ({"field": "takeovers", "one_of": []}, "at least 1 item"),
        ({"field": "takeovers", "max": 1, "when_missing": "ignore"}, "'fail' or 'pass'"),
        ({"field": "takeovers", "most": 1}, "most"),
        ({"field": "takeovers", "max": -1}, "field takeovers: max is -1, expected 0 or more"),
        ({"field": "collision.contacts", "equals": -1}, "field collision.contacts: equals is -1, expected 0 or more"),
        ({"field": "comfort.ego.within.longitudinal_jerk", "min": 95}, "min is 95, expected a share from 0 to 1"),
        ({"field": "ego_motion.log.off_road", "max": 1.5}, "max is 1.5, expected a share from 0 to 1"),
    ],
)
def test_a_criterion_that_cannot_be_meant_is_refused(limits: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Criterion(**limits)


def test_a_bad_file_names_line_and_field(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("runs:\n  - {field: takeovers, max: 1}\n  - {field: take_overs, max: 2}\n")
    with pytest.raises(
        InputError, match=r"limits\.yaml: line 3, field runs\.1: .*no field take_overs .*near: takeovers"
    ):
        Criteria.load("limits.yaml", tmp_path)


def test_two_criteria_of_one_name() -> None:
    with pytest.raises(ValidationError, match="runs: a more than once"):
        Criteria(runs=[{"name": "a", "field": "takeovers", "max": 1}, {"name": "a", "field": "steps", "min": 1}])


@pytest.mark.parametrize(
    ("limits", "value", "passed"),
    [
        ({"field": "passed_share", "min": 0.25}, 0.25, True),
        ({"field": "passed_share", "min": 0.5}, 0.25, False),
        ({"field": "runs", "min": 4}, 4, True),
        ({"field": "failed", "max": 0}, 1, False),
        ({"field": "errors", "max": 1}, 1, True),
        ({"field": "unfinished", "max": 0}, 1, False),
    ],
)
def test_counts_of_a_campaign(limits: dict[str, Any], value: float, passed: bool) -> None:
    found = SuiteCriterion(**limits).of_runs([PASSED, FAILED, ERROR, UNFINISHED])
    assert (found.value, found.passed) == (value, passed)


@pytest.mark.parametrize(
    ("aggregate", "value"), [("mean", 15.0), ("median", 15.0), ("min", 10.0), ("max", 20.0), ("sum", 30.0)]
)
def test_aggregates_of_a_measure(aggregate: str, value: float) -> None:
    found = SuiteCriterion(field="progress_m", aggregate=aggregate, min=0.0).of_runs([PASSED, FAILED])
    assert found.value == value and found.name == f"{aggregate} of progress_m at least 0"


def test_the_mean_of_true_and_false_is_a_share() -> None:
    assert SuiteCriterion(field="reactive", aggregate="mean", min=0.5).of_runs([PASSED, FAILED]).passed


def test_an_aggregate_over_runs_without_the_measure_fails_and_says_of_how_many() -> None:
    found = SuiteCriterion(field="progress_m", aggregate="mean", min=0.0).of_runs([PASSED, ERROR, UNFINISHED])
    assert not found.passed and found.reason == "progress_m is missing in 2 of 3 runs"
    left_out = SuiteCriterion(field="progress_m", aggregate="mean", min=0.0, when_missing="pass")
    assert left_out.of_runs([PASSED, ERROR]).value == 10.0


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"field": "progress_m", "min": 1}, "without aggregate, expected one, or a field among runs, passed"),
        ({"field": "progres_m", "aggregate": "mean", "min": 1}, r"no field progres_m .*near: progress_m"),
        ({"field": "why", "aggregate": "max", "min": 1}, "aggregate of what is no number"),
        ({"field": "progress_m", "aggregate": "mode", "min": 1}, "aggregate"),
        ({"field": "passed_share", "min": 95}, "field passed_share: min is 95, expected a share from 0 to 1"),
        ({"field": "passed_share", "equals": "all"}, "field passed_share never is all, expected a number"),
        ({"field": "passed_share", "one_of": [1, 2]}, "field passed_share: one_of is 2, expected a share from 0 to 1"),
        ({"field": "errors", "max": -1}, "field errors: max is -1, expected 0 or more"),
        ({"field": "reactive", "aggregate": "mean", "min": 90}, "mean of reactive: min is 90, expected a share"),
        ({"field": "reactive", "aggregate": "sum", "max": -1}, "sum of reactive: max is -1, expected 0 or more"),
    ],
)
def test_a_criterion_of_the_suite_that_cannot_be_meant_is_refused(limits: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        SuiteCriterion(**limits)


def test_bounds_that_a_measure_can_reach_are_taken() -> None:
    for limits in (
        {"field": "passed_share", "min": 0, "max": 1},
        {"field": "reactive", "aggregate": "sum", "min": 90},
        {"field": "comfort.ego.within.longitudinal_jerk", "aggregate": "sum", "min": 3},
        {"field": "progress_m", "aggregate": "min", "min": -2},
    ):
        assert SuiteCriterion(**limits).limit
    assert Criterion(field="progress_m", min=-2.0, max=500.0).limit


def verdict(suite: list[dict[str, Any]], outcomes: list[CaseOutcome]) -> tuple[bool, list[str]]:
    criteria = Criteria(runs=[{"field": "takeovers", "max": 1}], **({"suite": suite} if suite else {}))
    found = criteria.of_runs(outcomes)
    return all(each.passed for each in found), [each.name for each in found if not each.passed]


def test_where_a_suite_says_nothing_all_runs_must_pass() -> None:
    assert verdict([], [PASSED, PASSED]) == (True, [])
    assert verdict([], [PASSED, FAILED]) == (False, ["all runs pass"])
    assert verdict([], [PASSED, ERROR]) == (False, ["all runs pass"])
    assert verdict([], []) == (False, ["all runs pass"])


def test_errors_and_cases_not_run_never_pass_on_silence() -> None:
    mild = [{"field": "progress_m", "aggregate": "mean", "min": 0, "when_missing": "pass"}]
    assert verdict(mild, [PASSED, FAILED]) == (True, [])
    assert verdict(mild, [PASSED, ERROR]) == (False, ["no errors"])
    assert verdict(mild, [PASSED, UNFINISHED]) == (False, ["all runs are done"])
    assert verdict([{"field": "passed_share", "min": 0.5}], [PASSED, ERROR]) == (True, [])


def test_the_default_set_judges_a_good_run_and_every_bad_one() -> None:
    good: dict[str, Any] = {
        "collision": {"ego_at_fault": 0},
        "fault": {"of_ego": 0},
        "safety": {"min_own_ttc_s": 0.95},
        "ego_motion": {"off_road": 0.0, "progress_ratio": 0.2},
        "mission": {"off_route_m": 10.0, "goal_reached": True},
        "rules": {"wrong_way_m": 6.0},
        "comfort": {"ego": {"within": dict.fromkeys(("longitudinal_acceleration", "lateral_acceleration"), 0.95)}},
    }
    good["comfort"]["ego"]["within"]["longitudinal_jerk"] = 0.95
    criteria = Criteria.load()
    assert all(criterion.of_run(good).passed for criterion in criteria.runs)
    for criterion in criteria.runs:
        limit, step = (criterion.max, 1e-3) if criterion.min is None else (criterion.min, -1e-3)
        assert find_field(criterion.field).counts or criterion.equals is True
        assert not criterion.judge(False if limit is None else limit + step).passed
        assert not criterion.of_run({}).passed or criterion.when_missing == "pass"
