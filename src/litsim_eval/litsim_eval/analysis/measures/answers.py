"""The contacts of the ego that it answers for, as measures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from litsim_eval.analysis.measure import (
    KNOWN_OF_EGO,
    LOWER,
    Count,
    Listed,
    Metrics,
    family,
    moments_of,
)
from litsim_eval.analysis.measures.blame import Cause, Side
from litsim_eval.analysis.measures.fault import contact_verdicts, new_contacts
from litsim_sim.core.scene import STEP_S
from litsim_sim.record.run import Run

TEXTS = {
    Cause.WALKER: "on foot or on a bicycle",
    Cause.RED_LIGHT: "{who} had passed red",
    Cause.STANDING: "{who} ran into one that stood",
    Cause.WRONG_WAY: "{who} was on the wrong side",
    Cause.RIGHT_OF_WAY: "{who} did not give way",
    Cause.CROSSING: "their ways crossed",
    Cause.ENTERED: "{who} came from the side",
    Cause.FOLLOWED: "{who} ran into the one ahead",
    Cause.REVEALED: "another vehicle had hidden it",
    Cause.START: "it was that close from the first step on",
}


def _contacts(run: Run) -> list[dict[str, Any]]:
    return [
        {
            "agent": verdict.own.agent,
            "step": verdict.own.contact_step,
            "in_log": verdict.in_log,
            "of_ego": verdict.blame.of_ego,
            "cause": verdict.blame.cause.value,
            "by": verdict.blame.by.value,
            "perceived_step": verdict.own.perceived_step,
            "avoided": verdict.own.avoided,
            "other_perceived_step": None if verdict.other is None else verdict.other.perceived_step,
            "other_avoids": None if verdict.other is None else verdict.other.avoided,
        }
        for verdict in run.once(contact_verdicts)
    ]


def answered(metrics: Metrics) -> Iterator[Mapping[str, Any]]:
    """Yields the contacts that the ego answers for; the log has none of them."""
    yield from (contact for contact in metrics["fault"]["contacts"] if contact["of_ego"] and not contact["in_log"])


def cause_text(contact: Mapping[str, Any]) -> str:
    """Returns a sentence on an entry of `fault.contacts`: what led to it, and what a careful driver does."""
    who = {Side.EGO: "the ego", Side.OTHER: str(contact["agent"])}.get(contact["by"], "")
    text = TEXTS[Cause(contact["cause"])].format(who=who)
    if contact["by"] == Side.EGO and not contact["avoided"]:
        return f"{text}, and braking was too late by then"
    return f"{text}, a careful driver {'avoids it' if contact['avoided'] else 'hits too'}"


def _text(_: Any, __: str, metrics: Metrics) -> str:
    how = {(contact["agent"], contact["step"]): contact for contact in metrics["collision"]["ego_contacts"]}
    texts = []
    for contact in answered(metrics):
        agent, step = contact["agent"], contact["step"]
        hit = how[agent, step]
        kind = f"{hit['verdict'].replace('_', ' ')}, {hit['delta_v_mps']:.1f} m/s"
        texts.append(f"{agent} at {STEP_S * step:.1f} s ({kind}; {cause_text(contact)})")
    return f"contact at the ego's fault with {' and '.join(texts)}" if texts else ""


MEASURES = family(
    "contacts that the ego answers for, and the log has not: [the judge](#who-answers-for-a-contact)",
    Count(
        "fault.of_ego",
        lambda run: sum(contact.blame.of_ego for contact in new_contacts(run)),
        *("contacts at the ego's fault", "", LOWER),
        rows=KNOWN_OF_EGO,
        sentence=_text,
        moments=moments_of(answered),
    ),
    "for each contact of the ego: whether it answers for it, `cause`, and who created the situation (`by`); whether "
    "the careful and competent driver of UN R157 in its place avoids it, and from when on that driver perceives it "
    "(reaction 0.75 s, up to 0.774 g with 12.65 m/s³, from a wandering of 0.375 m in the next lane or a time to "
    "collision of 2 s on; the regulation's 0.4 s of evaluating the risk are left out, which is stricter); and as "
    "`other_…` the same in the other's place (null for a pedestrian or a cyclist)",
    Listed("fault.contacts", _contacts),
)
