"""Takeovers and contacts as rows that lead to a step and an agent."""

from typing import Any

from litsim_eval.report.events import contact_table, takeover_table

ENTRY = {"agent": 2, "opponent": 1, "reason": "log_collision", "detected_step": 20, "time_to_conflict_s": 2.5}


def cells(**more: Any) -> dict[str, str]:
    """Texts by column of the takeover with `more` fields."""
    table = takeover_table([ENTRY | more], 0.1, ego=1)
    (row,) = table.rows
    assert (row.step, row.agent) == (20, 2)
    return dict(zip(table.head, row.cells, strict=True))


def test_a_takeover() -> None:
    hit = {"replay_would_collide": True, "replay_opponent": 1, "replay_step": 33}
    assert cells(**hit, overlap_probability=0.4, held_s=2.0, released_step=45, residual_m=0.5) == {
        "agent": "2",
        "opponent": "ego 1",
        "why": "log collision",
        "at": "2.0 s",
        "predicted overlap": "in 2.5 s, p = 0.40",
        "the log alone": "hits ego 1 at 3.3 s",
        "off its log for": "2.0 s",
        "back at": "4.5 s",
        "distance then": "0.50 m",
    }


def test_a_takeover_that_never_ends_and_was_for_nothing() -> None:
    found = cells(false_alarm=True, residual_m=0.5)
    assert found["the log alone"] == "false alarm: no contact"
    assert found["predicted overlap"] == "in 2.5 s"
    assert found["back at"] == found["distance then"] == found["off its log for"] == "–"


def test_a_takeover_that_ends_in_own_intent_and_that_no_forecast_predicted() -> None:
    found = cells(outcome="own_intent", own_intent_step=47, released_step=None, time_to_conflict_s=None)
    assert (found["back at"], found["predicted overlap"]) == ("own intent from 4.7 s", "–")


def test_contacts() -> None:
    verdict = {"agent": 5, "step": 31, "in_log": False, "verdict": "active_front", "ego_at_fault": True}
    verdict |= {"delta_v_mps": 3.21}
    why = {"cause": "followed", "by": "ego", "avoided": True, "other_avoids": False}
    found = [{"pair": [1, 5], "step": 31, "in_log": False}, {"pair": [7, 8], "step": 12, "in_log": True}]
    metrics: dict[str, Any] = {
        "collision": {"contacts": found, "ego_contacts": [verdict]},
        "fault": {"contacts": [{"agent": 5, "step": 31, "of_ego": True, **why}]},
    }
    ego, others = contact_table(metrics, 0.1, ego=1).rows
    assert (ego.step, ego.agent) == (31, 5)
    said = "active front: the ego answers for it; the ego ran into the one ahead, a careful driver avoids it"
    said += ", in the other's place hits too"
    assert ego.cells == ("ego 1", "5", "3.1 s", "no", said, "3.2 m/s")
    assert (others.step, others.agent) == (12, 7)
    assert others.cells == ("7", "8", "1.2 s", "yes", "–", "–")
    verdict["in_log"] = True
    assert "active front: no fault; the ego ran" in contact_table(metrics, 0.1, ego=1).rows[0].cells[4]
