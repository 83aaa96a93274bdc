"""Which failures count: those for which the ego answers, and not what the background forces."""

from typing import Any

import pytest

from campaigns import cases
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.results import RunResult
from litsim_eval.search.judging import Outcome, closeness, missed_by, outcome_of

OTHER, HITS_IT = 7, 9
FREE = 10


def contact(agent: int, step: int, *, of_ego: bool) -> dict[str, Any]:
    """An entry of `fault.contacts`."""
    cause = {"cause": "followed", "by": "ego" if of_ego else "other", "avoided": False}
    return {"agent": agent, "step": step, "in_log": False, "of_ego": of_ego, **cause}


def result(*contacts: dict[str, Any], off_road: float = 0.0, red_at: int | None = None) -> RunResult:
    """Returns a run with contacts, and a red light."""
    of_ego = [each for each in contacts if each["of_ego"]]
    hit = [{**each, "verdict": "front", "delta_v_mps": 2.0} for each in contacts]
    metrics: dict[str, Any] = {
        "valid": True,
        "collision": {"ego_contacts": hit},
        "fault": {"contacts": sorted(contacts, key=lambda each: each["step"]), "of_ego": len(of_ego)},
        "signals": {
            "red_ego": int(red_at is not None),
            "reds": [{"by": "ego", "step": red_at, "connection": "a"}] * (red_at is not None),
        },
        "safety": {"min_own_ttc_s": 1.5, "min_ttc_s": 1.0, "min_headway_s": None},
        "ego_motion": {"off_road": off_road},
    }
    return RunResult.judged(cases()[0], metrics, Criteria.load("safety"))


OWN, FORCED = contact(OTHER, 50, of_ego=True), contact(OTHER, 50, of_ego=False)


def test_contacts() -> None:
    assert outcome_of(result(OWN), FREE) == Outcome.FAILED
    assert outcome_of(result(FORCED), FREE) == Outcome.PASSED


def test_what_follows_a_forced_contact_is_forced() -> None:
    assert outcome_of(result(FORCED, off_road=0.1), FREE) == Outcome.FORCED
    assert outcome_of(result(off_road=0.1), FREE) == Outcome.FAILED


def test_what_follows_when_it_was_hit_is_forced() -> None:
    assert outcome_of(result(OWN, contact(HITS_IT, 30, of_ego=False)), FREE) == Outcome.FORCED
    hit_later = result(OWN, contact(HITS_IT, 70, of_ego=False))
    assert outcome_of(hit_later, FREE) == Outcome.FAILED and missed_by(hit_later) == "no contact at fault, followed"


@pytest.mark.parametrize(("red_at", "outcome"), [(40, Outcome.FAILED), (60, Outcome.FORCED)])
def test_a_red_light_counts_unless_a_forced_contact_came_before(red_at: int, outcome: Outcome) -> None:
    assert outcome_of(result(FORCED, red_at=red_at), FREE) == outcome


def test_a_red_light_just_ahead_when_the_ego_began_to_drive_is_forced() -> None:
    run = result(red_at=50)
    assert [outcome_of(run, free) for free in (20, 45)] == [Outcome.FAILED, Outcome.FORCED]


def test_groups_and_errors() -> None:
    assert missed_by(result(OWN)) == "no contact at fault, followed"
    assert missed_by(result(off_road=0.1)) == "on the road"
    assert outcome_of(RunResult.error(cases()[0], "it crashed"), FREE) == Outcome.ERROR


def test_closeness_is_by_the_time_to_a_collision_of_its_own() -> None:
    assert closeness(result(FORCED).metrics) == pytest.approx(0.5)
    assert closeness(None) == 0.0
