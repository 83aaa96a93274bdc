"""Which failures count: those of the stack, and not those that the background forces."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from litsim_eval.analysis.careful_driver import TTC_S
from litsim_eval.analysis.measures.signals import red_lights
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.results import RunResult
from litsim_sim.core.scene import STEP_S

OF_CONTACTS = {"fault.of_ego", "collision.ego_at_fault", "safety.min_own_ttc_s"}
"""Criteria that a run misses because of contacts."""
RED = "signals.red_ego"
NEAR_TTC_S, NEAR_HEADWAY_S = 3.0, 3.0  # from which on a run is not near to a contact


class Outcome(StrEnum):
    """What became of a run with changes."""

    PASSED = "passed"
    FAILED = "failed"  # by the stack
    FORCED = "forced"  # by the background, or by how the ego started
    ERROR = "error"  # not judged


def outcome_of(result: RunResult, free_step: int) -> Outcome:
    """Returns what became of a run in which the ego drives from `free_step` on.

    Of contacts the first decides: what follows, such as contacts of a vehicle that was hit, is a consequence. It counts
    if the ego answers for it (:mod:`litsim_eval.analysis.measures.blame`); otherwise the run is forced. So is one with
    nothing but red lights just after the ego began to drive, within the time to collision at which the careful driver
    of UN Regulation 157 perceives a risk.
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
    if first:
        return Outcome.FAILED if any(contact["of_ego"] for contact in first) else Outcome.FORCED
    only_reds = {criterion.field for criterion in result.criteria if not criterion.passed} == {RED}
    return Outcome.FORCED if only_reds else Outcome.FAILED


def first_contacts(metrics: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Returns the ego's contacts at the first step with any that the log has not."""
    new = [contact for contact in metrics["fault"]["contacts"] if not contact["in_log"]]
    return [contact for contact in new if contact["step"] == new[0]["step"]]


def missed_by(result: RunResult) -> str:
    """Returns what happened first in a run that failed, for its group: the criterion, and the kind of contact."""
    criterion = next(criterion for criterion in result.criteria if not criterion.passed)
    first = first_contacts(result.metrics or {}) if criterion.field in OF_CONTACTS else []
    return ", ".join([criterion.name, *(str(contact["cause"]).replace("_", " ") for contact in first[:1])])


def closeness(metrics: Mapping[str, Any] | None) -> float:
    """Returns how near the ego came to a contact of its own, from 0 to 1: by time to collision and headway."""
    if metrics is None:
        return 0.0
    ttc, headway = metrics["safety"]["min_own_ttc_s"], metrics["safety"]["min_headway_s"]
    by_ttc = 0.0 if ttc is None else 1.0 - min(ttc, NEAR_TTC_S) / NEAR_TTC_S
    by_headway = 0.0 if headway is None else 0.3 * (1.0 - min(headway, NEAR_HEADWAY_S) / NEAR_HEADWAY_S)
    return max(by_ttc, by_headway)
