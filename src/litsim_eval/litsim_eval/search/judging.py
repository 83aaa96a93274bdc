"""Which failures count: those of the stack, and not those that the background forces."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.reasons import avoidable, red_lights
from litsim_eval.campaign.results import RunResult
from litsim_eval.search.space import Proposal

OF_CONTACTS = {"collision.ego_at_fault", "safety.avoidable_contacts", "safety.min_own_ttc_s"}
"""Criteria that a run misses because of contacts."""
TTC_S, HEADWAY_S = 3.0, 3.0  # [s] from which on a run is not near to a contact


class Outcome(StrEnum):
    """What became of a run with changes."""

    PASSED = "passed"
    FAILED = "failed"  # by the stack
    FORCED = "forced"  # a contact that the background forces
    ERROR = "error"  # not judged


def outcome_of(result: RunResult, proposal: Proposal) -> Outcome:
    """Returns what became of a run.

    Of contacts the first decides: what follows, such as contacts of a vehicle that was hit, is a consequence. It counts
    if the ego is at fault, or if the careful driver of UN Regulation 157 avoids it in the ego's place. One with the
    agent that cuts in counts only if the careful driver avoids it: the metric of fault does not know who came into
    whose way. A run whose first contact does not count is forced, unless the ego passed a red light before.
    """
    if result.verdict == Verdict.ERROR:
        return Outcome.ERROR
    if result.verdict == Verdict.PASSED:
        return Outcome.PASSED
    metrics = result.metrics or {}
    first, reds = first_contacts(metrics), red_lights(metrics) if metrics.get("signals") else ()
    if not first or any(each["step"] <= first[0]["step"] for each in reds):
        return Outcome.FAILED
    careful = {each["agent"] for each in avoidable(metrics)}
    cutting_in = proposal.agent if proposal.act == "cut_in" else None
    counts = any(each["agent"] in careful or (each["ego_at_fault"] and each["agent"] != cutting_in) for each in first)
    return Outcome.FAILED if counts else Outcome.FORCED


def first_contacts(metrics: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Returns the ego's contacts at the first step with any that the log has not."""
    new = [each for each in metrics["collision"]["ego_contacts"] if not each["in_log"]]
    return [each for each in new if each["step"] == new[0]["step"]]


def missed_by(result: RunResult) -> str:
    """Returns what happened first in a run that failed, for its group: the criterion, and the kind of contact."""
    criterion = next(each for each in result.criteria if not each.passed)
    first = first_contacts(result.metrics or {}) if criterion.field in OF_CONTACTS else []
    return ", ".join([criterion.name, *(str(each["verdict"]).replace("_", " ") for each in first[:1])])


def closeness(metrics: Mapping[str, Any] | None) -> float:
    """Returns how near the ego came to a contact of its own, from 0 to 1: by time to collision and headway."""
    if metrics is None:
        return 0.0
    ttc, headway = metrics["safety"]["min_own_ttc_s"], metrics["safety"]["min_headway_s"]
    by_ttc = 0.0 if ttc is None else 1.0 - min(ttc, TTC_S) / TTC_S
    by_headway = 0.0 if headway is None else 0.3 * (1.0 - min(headway, HEADWAY_S) / HEADWAY_S)
    return max(by_ttc, by_headway)
