"""Which failures count: those of the stack, and not those that the background forces."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from litsim_eval.analysis.measures.careful_driver import TTC_S
from litsim_eval.analysis.measures.safety import avoidable
from litsim_eval.analysis.measures.signals import red_lights
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.results import RunResult
from litsim_eval.search.space import Proposal
from litsim_sim.core.scene import STEP_S

OF_CONTACTS = {"collision.ego_at_fault", "safety.avoidable_contacts", "safety.min_own_ttc_s"}
"""Criteria that a run misses because of contacts."""
RED = "signals.red_ego"
NEAR_TTC_S, NEAR_HEADWAY_S = 3.0, 3.0  # from which on a run is not near to a contact


class Outcome(StrEnum):
    """What became of a run with changes."""

    PASSED = "passed"
    FAILED = "failed"  # by the stack
    FORCED = "forced"  # by the background, or by how the ego started
    ERROR = "error"  # not judged


def outcome_of(result: RunResult, proposal: Proposal, free_step: int) -> Outcome:
    """Returns what became of a run in which the ego drives from `free_step` on.

    Of contacts the first decides: what follows, such as contacts of a vehicle that was hit, is a consequence. It counts
    if the ego is at fault, or if the careful driver of UN Regulation 157 avoids it in the ego's place. Two kinds count
    only if the careful driver avoids them, by braking while the ego is free: those within the time to collision at
    which that driver perceives a risk, which was there when the ego began to drive; and those with the agent that cuts
    in, as the metric of fault does not know who came into whose way. A run whose first contact does not count is
    forced, and so is one with nothing but red lights in that first time.
    """
    if result.verdict == Verdict.ERROR:
        return Outcome.ERROR
    if result.verdict == Verdict.PASSED:
        return Outcome.PASSED
    metrics, own_from = result.metrics or {}, free_step + round(TTC_S / STEP_S)
    first = first_contacts(metrics)
    reds = [light["step"] for light in (red_lights(metrics) if metrics.get("signals") else ())]
    if any(step >= own_from and (not first or step <= first[0]["step"]) for step in reds):
        return Outcome.FAILED
    if not first:
        only_reds = {criterion.field for criterion in result.criteria if not criterion.passed} == {RED}
        return Outcome.FORCED if only_reds else Outcome.FAILED
    careful = {contact["agent"]: contact["perceived_step"] for contact in avoidable(metrics)}
    cutting_in = proposal.agent if proposal.act == "cut_in" else None

    def counts(contact: Mapping[str, Any]) -> bool:
        if contact["step"] < own_from or contact["agent"] == cutting_in:
            return bool(careful.get(contact["agent"], -1) >= free_step)
        return contact["ego_at_fault"] or contact["agent"] in careful

    return Outcome.FAILED if any(map(counts, first)) else Outcome.FORCED


def first_contacts(metrics: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Returns the ego's contacts at the first step with any that the log has not."""
    new = [contact for contact in metrics["collision"]["ego_contacts"] if not contact["in_log"]]
    return [contact for contact in new if contact["step"] == new[0]["step"]]


def missed_by(result: RunResult) -> str:
    """Returns what happened first in a run that failed, for its group: the criterion, and the kind of contact."""
    criterion = next(criterion for criterion in result.criteria if not criterion.passed)
    first = first_contacts(result.metrics or {}) if criterion.field in OF_CONTACTS else []
    return ", ".join([criterion.name, *(str(contact["verdict"]).replace("_", " ") for contact in first[:1])])


def closeness(metrics: Mapping[str, Any] | None) -> float:
    """Returns how near the ego came to a contact of its own, from 0 to 1: by time to collision and headway."""
    if metrics is None:
        return 0.0
    ttc, headway = metrics["safety"]["min_own_ttc_s"], metrics["safety"]["min_headway_s"]
    by_ttc = 0.0 if ttc is None else 1.0 - min(ttc, NEAR_TTC_S) / NEAR_TTC_S
    by_headway = 0.0 if headway is None else 0.3 * (1.0 - min(headway, NEAR_HEADWAY_S) / NEAR_HEADWAY_S)
    return max(by_ttc, by_headway)
