"""What is said of a run that has not passed."""

from typing import Any

import pytest

from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.results import judge

CONTACT = {"agent": 31, "step": 181, "verdict": "front", "ego_at_fault": True, "in_log": False, "delta_v_mps": 3.25}
CAUSE = {"cause": "red_light", "by": "other", "avoided": True}
FAULT = {"agent": 31, "step": 181, "in_log": False, "of_ego": True} | CAUSE
OF_EGO = "contact at the ego's fault with 31 at 18.1 s (front, 3.2 m/s; 31 had passed red, a careful driver avoids it)"
STANDOFF = "ego and 12 stand for each other from 8.2 s to the end, 12 could go first"
METRICS: dict[str, Any] = {
    "collision": {
        "ego_at_fault": 1,
        "ego_contacts": [
            CONTACT,
            CONTACT | {"agent": 5, "in_log": True},
            CONTACT | {"agent": 6, "ego_at_fault": False},
        ],
    },
    "safety": {"min_own_ttc_s": 0.0},
    "fault": {
        "of_ego": 1,
        "contacts": [FAULT, FAULT | {"agent": 5, "in_log": True}, FAULT | {"agent": 6, "of_ego": False}],
    },
    "signals": {"red_ego": 1, "reds": [{"by": "log", "step": 9}, {"by": "ego", "step": 142, "connection": "A -> B"}]},
    "ego_motion": {"off_road": 0.125, "progress_ratio": 0.138},
    "comfort": {"ego": {"within": {"longitudinal_jerk": 0.9412}}},
    "minimum_risk_s": 2.5,
    "standoffs": [{"agent": 12, "step": 82, "end_step": 200, "could_go_first": "other", "resolved": False}],
}


@pytest.mark.parametrize(
    ("criterion", "said"),
    [
        (
            {"field": "collision.ego_at_fault", "max": 0},
            "contact at the ego's fault with 31 at 18.1 s (front, 3.2 m/s)",
        ),
        ({"field": "fault.of_ego", "max": 0}, OF_EGO),
        ({"field": "signals.red_ego", "max": 0}, "red light passed, A -> B at 14.2 s"),
        ({"field": "minimum_risk_s", "max": 0}, "ego: minimum-risk manoeuvres 2.50 s, expected at most 0 s"),
        ({"field": "ego_motion.off_road", "max": 0}, "ego: off the road 12.5 %, expected at most 0 %"),
        ({"field": "safety.min_own_ttc_s", "min": 0.95}, "shortest own TTC 0 s by that contact"),
        (
            {"field": "ego_motion.progress_ratio", "min": 0.2},
            f"the ego came 13.8 % as far as its log, expected at least 20 %; {STANDOFF}",
        ),
        (
            {"field": "standoffs", "max": 0},
            STANDOFF,
        ),
        (
            {"field": "comfort.ego.within.longitudinal_jerk", "min": 0.95},
            "jerk along the way within -4.13 to 4.13 m/s³ at 94.1 % of the steps, expected at least 95 %",
        ),
        ({"name": "own", "field": "takeovers", "max": 3}, "own: takeovers is missing"),
    ],
)
def test_a_reason_says_what_happened(criterion: dict[str, Any], said: str) -> None:
    (result,) = judge(METRICS, Criteria(runs=[criterion]))
    assert (result.passed, result.reason) == (False, said)


def test_measures_of_earlier_versions_are_told_as_numbers() -> None:
    bare = {"collision": {"ego_at_fault": 2}}
    (result,) = judge(bare, Criteria(runs=[{"name": "fault", "field": "collision.ego_at_fault", "max": 0}]))
    assert result.reason == "fault: collision.ego_at_fault is 2, expected at most 0"


def test_without_a_contact_the_time_to_collision_is_told() -> None:
    metrics = METRICS | {"safety": {"min_own_ttc_s": 0.5}, "fault": {"of_ego": 0, "contacts": []}}
    (result,) = judge(metrics, Criteria.model_validate({"runs": [{"field": "safety.min_own_ttc_s", "min": 0.95}]}))
    assert result.reason == "shortest own TTC 0.50 s, expected at least 0.95 s"


def test_of_an_ego_that_created_it_no_driver_is_told_who_hits_too() -> None:
    fault = FAULT | {"cause": "entered", "by": "ego", "avoided": False}
    (result,) = judge(
        METRICS | {"fault": {"of_ego": 1, "contacts": [fault]}},
        Criteria.model_validate({"runs": [{"field": "fault.of_ego", "max": 0}]}),
    )
    assert result.reason.endswith("the ego came from the side, and braking was too late by then)")
