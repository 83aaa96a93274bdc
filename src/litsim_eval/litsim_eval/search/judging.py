"""Which failures count: those of the stack, and not those that the background forces."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.reasons import at_fault, avoidable
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

    A contact counts if the ego is at fault, or if the careful driver of UN Regulation 157 avoids it in the ego's place.
    One with the agent that cuts in counts only if the careful driver avoids it: the metric of fault does not know who
    came into whose way. A run that misses criteria, but only has contacts that do not count, is forced.
    """
    if result.verdict == Verdict.ERROR:
        return Outcome.ERROR
    if result.verdict == Verdict.PASSED:
        return Outcome.PASSED
    metrics = result.metrics or {}
    careful = {each["agent"] for each in avoidable(metrics)}
    cutting_in = proposal.agent if proposal.act == "cut_in" else None
    counts = careful | {each["agent"] for each in at_fault(metrics) if each["agent"] != cutting_in}
    new = [each for each in metrics["collision"]["ego_contacts"] if not each["in_log"]]
    if new and not counts:
        return Outcome.FORCED
    return Outcome.FAILED


def missed_by(result: RunResult) -> str:
    """Returns what happened first in a run that failed, for its group: the criterion, and the kind of contact."""
    criterion = next(each for each in result.criteria if not each.passed)
    contacts = [*at_fault(result.metrics or {})]
    kind = contacts[0]["verdict"] if contacts and criterion.field in OF_CONTACTS else ""
    return ", ".join(part for part in (criterion.name, str(kind).replace("_", " ")) if part)


def closeness(metrics: Mapping[str, Any] | None) -> float:
    """Returns how near the ego came to a contact of its own, from 0 to 1: by time to collision and headway."""
    if metrics is None:
        return 0.0
    ttc, headway = metrics["safety"]["min_own_ttc_s"], metrics["safety"]["min_headway_s"]
    by_ttc = 0.0 if ttc is None else 1.0 - min(ttc, TTC_S) / TTC_S
    by_headway = 0.0 if headway is None else 0.3 * (1.0 - min(headway, HEADWAY_S) / HEADWAY_S)
    return max(by_ttc, by_headway)
