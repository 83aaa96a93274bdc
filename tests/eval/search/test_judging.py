"""Which failures count: fault, what a careful driver avoids, and what the background forces."""

from typing import Any

import pytest

from campaigns import cases
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.results import RunResult
from litsim_eval.search.judging import Outcome, closeness, missed_by, outcome_of
from litsim_eval.search.space import Proposal

OTHER = 7
CUT_IN, BRAKE = Proposal("cut_in", OTHER, 4.0), Proposal("brake", OTHER, 4.0)


FREE = 10
HIT = {"agent": 9, "ego_at_fault": False, "in_log": False, "verdict": "rear", "delta_v_mps": 2.0}


def result(
    *,
    fault: bool,
    avoided: bool,
    contact: bool = True,
    off_road: float = 0.0,
    hit_at: int | None = None,
    red_at: int | None = None,
    perceived_at: int = 40,
) -> RunResult:
    """Returns a run with a contact at step 50, one by which the ego is hit from behind, and a red light."""
    verdict = {
        "agent": OTHER,
        "step": 50,
        "ego_at_fault": fault,
        "in_log": False,
        "verdict": "front",
        "delta_v_mps": 2.0,
    }
    careful = {"agent": OTHER, "step": 50, "avoided": avoided, "perceived_step": perceived_at}
    metrics: dict[str, Any] = {
        "valid": True,
        "collision": {
            "ego_contacts": sorted(
                [verdict] * contact + [HIT | {"step": hit_at}] * (hit_at is not None), key=lambda each: each["step"]
            ),
            "ego_at_fault": int(fault and contact),
        },
        "signals": {
            "red_ego": int(red_at is not None),
            "reds": [{"by": "ego", "step": red_at}] * (red_at is not None),
        },
        "safety": {
            "careful_driver": [careful] if contact else [],
            "avoidable_contacts": int(avoided and contact),
            "min_own_ttc_s": 1.5,
            "min_ttc_s": 1.0,
            "min_headway_s": None,
        },
        "ego_motion": {"off_road": off_road},
    }
    return RunResult.judged(cases()[0], metrics, Criteria.load("safety"))


@pytest.mark.parametrize(
    ("fault", "avoided", "proposal", "outcome"),
    [
        (True, True, BRAKE, Outcome.FAILED),
        (True, False, BRAKE, Outcome.FAILED),
        (False, True, BRAKE, Outcome.FAILED),
        (True, True, CUT_IN, Outcome.FAILED),
        (True, False, CUT_IN, Outcome.FORCED),
        (False, False, BRAKE, Outcome.PASSED),
    ],
)
def test_contacts(fault: bool, avoided: bool, proposal: Proposal, outcome: Outcome) -> None:
    assert outcome_of(result(fault=fault, avoided=avoided), proposal, FREE) == outcome


def test_what_follows_a_forced_contact_is_forced() -> None:
    assert outcome_of(result(fault=False, avoided=False, off_road=0.1), BRAKE, FREE) == Outcome.FORCED
    assert outcome_of(result(fault=False, avoided=False, off_road=0.1, contact=False), BRAKE, FREE) == Outcome.FAILED


def test_what_follows_when_it_was_hit_is_forced() -> None:
    assert outcome_of(result(fault=True, avoided=True, hit_at=30), BRAKE, FREE) == Outcome.FORCED
    hit_later = result(fault=True, avoided=True, hit_at=70)
    assert outcome_of(hit_later, BRAKE, FREE) == Outcome.FAILED and missed_by(hit_later) == "no contact at fault, front"


@pytest.mark.parametrize(("red_at", "outcome"), [(40, Outcome.FAILED), (60, Outcome.FORCED)])
def test_a_red_light_counts_unless_a_forced_contact_came_before(red_at: int, outcome: Outcome) -> None:
    assert outcome_of(result(fault=False, avoided=False, red_at=red_at), BRAKE, FREE) == outcome


@pytest.mark.parametrize(
    ("avoided", "perceived_at", "free", "outcome"),
    [
        (False, 50, 40, Outcome.FORCED),
        (True, 45, 40, Outcome.FAILED),
        (True, 35, 40, Outcome.FORCED),  # before the ego drove
        (False, 50, 30, Outcome.FAILED),
    ],
)
def test_a_risk_that_was_there_when_the_ego_began_to_drive(
    avoided: bool, perceived_at: int, free: int, outcome: Outcome
) -> None:
    run = result(fault=True, avoided=avoided, perceived_at=perceived_at)
    assert outcome_of(run, Proposal(z={"start.faster": 3.0}), free) == outcome


def test_a_red_light_just_ahead_when_the_ego_began_to_drive_is_forced() -> None:
    run = result(fault=False, avoided=False, contact=False, red_at=50)
    assert [outcome_of(run, BRAKE, free) for free in (20, 45)] == [Outcome.FAILED, Outcome.FORCED]


def test_groups_and_errors() -> None:
    assert missed_by(result(fault=True, avoided=True)) == "no contact at fault, front"
    assert missed_by(result(fault=False, avoided=False, contact=False, off_road=0.1)) == "on the road"
    assert outcome_of(RunResult.error(cases()[0], "it crashed"), BRAKE, FREE) == Outcome.ERROR


def test_closeness_is_by_the_time_to_a_collision_of_its_own() -> None:
    assert closeness(result(fault=False, avoided=False).metrics) == pytest.approx(0.5)
    assert closeness(None) == 0.0
