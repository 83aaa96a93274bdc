"""Collisions by fault: which agent is at fault, who answers for those of the ego, and what a careful driver avoids."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from litsim_eval.analysis.careful_driver import CarefulDriver, careful_driver
from litsim_eval.analysis.measure import (
    HIGHER,
    KNOWN_OF_EGO,
    LOWER,
    MEAN,
    MEAN_CONTROLLED,
    Better,
    Count,
    Listed,
    Measure,
    Metrics,
    Row,
    Share,
    Table,
    Truth,
    family,
    moments_of,
    share_of,
    total,
)
from litsim_eval.analysis.measures.blame import Blame, Cause, Side, blame
from litsim_eval.analysis.measures.collision import Collisions, EgoContact, collisions
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

CAUSES = {
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


@dataclass(frozen=True)
class ContactVerdict:
    """One contact of the ego, with the verdicts of the careful driver in place of the ego and of the other agent.

    Attributes:
        contact: the contact, with nuPlan's attribution.
        in_log: whether the log contains it too; then no agent of the run is at fault.
        own: verdict on the driver in place of the ego.
        other: verdict on the driver in place of the other agent; None if that is a pedestrian or a cyclist.
        blame: what led to it, and who answers for it.
    """

    contact: EgoContact
    in_log: bool
    own: CarefulDriver
    other: CarefulDriver | None
    blame: Blame


def contact_verdicts(run: Run) -> list[ContactVerdict]:
    """Returns verdicts on the ego's contacts, in the order of the collisions of `run`."""
    return [_verdict(run, contact) for contact in hits(run).ego]


def _verdict(run: Run, contact: EgoContact) -> ContactVerdict:
    ego, agent, step = run.info.ego_id, contact.agent, contact.step
    dt, lane_map = run.info.dt, lane_map_of(run)
    own = careful_driver(run.simulated, ego, agent, step, dt, lane_map)
    walks = _walks(run, contact)
    other = None if walks else careful_driver(run.simulated, agent, ego, step, dt, lane_map, sees_all=True)
    in_log = (min(ego, agent), max(ego, agent)) not in hits(run).excess
    return ContactVerdict(contact, in_log, own, other, blame(run, contact, own, other))


def hits(run: Run) -> Collisions:
    """Returns the collisions of a run."""
    return run.once(collisions)


def new_contacts(run: Run) -> list[ContactVerdict]:
    """Returns the verdicts on contacts of the ego that the log has not."""
    return [verdict for verdict in run.once(contact_verdicts) if not verdict.in_log]


def count_faults(run: Run) -> dict[str, int]:
    """Counts pairs of agents with contacts that are not in the log, by fault.

    A contact between two background agents is always the fault of the background. A contact at the fault of the ego is
    avoidable if the careful driver in place of the other agent would have avoided it.
    """
    among = sum(run.info.ego_id not in pair for pair in hits(run).excess)
    new = new_contacts(run)
    ego = [contact for contact in new if contact.contact.ego_at_fault]
    avoidable = sum(contact.other is not None and contact.other.avoided for contact in ego)
    return {
        "background": among + len(new) - len(ego),
        "ego_avoidable": avoidable,
        "ego_unavoidable": len(ego) - avoidable,
    }


def _walks(run: Run, contact: EgoContact) -> bool:
    table = run.steps[int(run.steps.step.searchsorted(contact.step))]
    return bool(table.obstacle[table.row(contact.agent)])


def at_fault(metrics: Metrics) -> Iterator[Mapping[str, Any]]:
    """Yields the contacts at the ego's fault that the log has not."""
    yield from (
        contact for contact in metrics["collision"]["ego_contacts"] if contact["ego_at_fault"] and not contact["in_log"]
    )


def answered(metrics: Metrics) -> Iterator[Mapping[str, Any]]:
    """Yields the contacts that the ego answers for; the log has none of them."""
    yield from (contact for contact in metrics["fault"]["contacts"] if contact["of_ego"] and not contact["in_log"])


def cause_text(contact: Mapping[str, Any]) -> str:
    """Returns a sentence on an entry of `fault.contacts`: what led to it, and what a careful driver does."""
    who = {Side.EGO: "the ego", Side.OTHER: str(contact["agent"])}.get(contact["by"], "")
    text = CAUSES[Cause(contact["cause"])].format(who=who)
    if contact["by"] == Side.EGO and not contact["avoided"]:
        return f"{text}, and braking was too late by then"
    return f"{text}, a careful driver {'avoids it' if contact['avoided'] else 'hits too'}"


def _sentence(contacts: Iterable[tuple[Mapping[str, Any], str]]) -> str:
    """Returns a sentence on entries of `collision.ego_contacts` with what is to be added to each; empty for none."""
    texts = [
        f"{contact['agent']} at {STEP_S * contact['step']:.1f} s ({contact['verdict'].replace('_', ' ')}, "
        f"{contact['delta_v_mps']:.1f} m/s{more})"
        for contact, more in contacts
    ]
    return f"contact at the ego's fault with {' and '.join(texts)}" if texts else ""


def _at_fault_text(_: Any, __: str, metrics: Metrics) -> str:
    return _sentence((contact, "") for contact in at_fault(metrics))


def _answered_text(_: Any, __: str, metrics: Metrics) -> str:
    how = {(contact["agent"], contact["step"]): contact for contact in metrics["collision"]["ego_contacts"]}
    return _sentence(
        (how[contact["agent"], contact["step"]], f"; {cause_text(contact)}") for contact in answered(metrics)
    )


def _by_kind(run: Run) -> dict[str, int]:
    """Returns the number of pairs with a contact of an agent of each kind."""
    kinds = {
        agent: int(own.stacked.kind[own.track(agent)[-1]])
        for group, own in run.simulated.groups(hits(run).colliding)
        for agent in group
    }
    touching = [{kinds[agent] for agent in pair} for pair in hits(run).first]
    return {kind.name.lower(): sum(int(kind) in pair for pair in touching) for kind in Kind}


def _all_contacts(run: Run) -> list[dict[str, Any]]:
    return [
        {"pair": list(contact.pair), "step": contact.first, "last_step": contact.last, "in_log": in_log}
        for contact, in_log in zip(hits(run).contacts, hits(run).in_log, strict=True)
    ]


def _ego_contacts(run: Run) -> list[dict[str, Any]]:
    return [
        {
            "agent": verdict.contact.agent,
            "step": verdict.contact.step,
            "in_log": verdict.in_log,
            "verdict": verdict.contact.verdict.value,
            "ego_at_fault": verdict.contact.ego_at_fault,
            "delta_v_mps": verdict.contact.delta_v,
        }
        for verdict in run.once(contact_verdicts)
    ]


def _answers(run: Run) -> list[dict[str, Any]]:
    return [
        {
            "agent": verdict.contact.agent,
            "step": verdict.contact.step,
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


def _rate(which: str, of: str) -> Callable[[Run], float | None]:
    """Returns the function of the share of some agents that others are, by names of :class:`Collisions`."""

    def value(run: Run) -> float | None:
        whole = getattr(hits(run), of)
        return share_of(len(getattr(hits(run), which) & whole), len(whole))

    return value


def _of_fault(name: str, title: str, row: Row, better: Better = LOWER) -> Measure:
    """Returns the measure of one of :func:`count_faults`."""
    value, path = (lambda run: run.once(count_faults)[name]), f"collision.by_fault.{name}"
    return Count(path, value, title, better=better, rows=(row,))


COLLIDING, EXCESS = (Row("colliding_agents"),), (Row("excess_pairs", table=Table.NONE),)
REACTIVE = (
    Row(
        "colliding_runs",
        *(total, Table.EGO, "runs with new contacts"),
        figure=lambda run: not run["reactive"],
        better=LOWER,
    ),
    Row(share=True, of_all=True),
)
MEASURES = family(
    "agents and pairs whose boxes overlap; a pair counts once",
    Count("collision.agents", lambda run: len(hits(run).colliding), "colliding agents", "", LOWER, rows=COLLIDING),
    Count("collision.pairs", lambda run: len(hits(run).first), better=LOWER),
    "colliding agents over all agents; over those ever under control ([formulas](#as-in-the-papers-table))",
    Share("collision.rate_all", _rate("colliding", "agents"), "collision rate, all", "", LOWER, rows=MEAN),
    Share(
        *("collision.rate_controlled", _rate("colliding", "controlled"), "collision rate, controlled", "", LOWER),
        rows=MEAN_CONTROLLED,
    ),
    "the same without the contacts that are also in the log",
    Count("collision.excess_agents", lambda run: len(hits(run).colliding_beyond_log), better=LOWER),
    Share("collision.excess_rate_all", _rate("colliding_beyond_log", "agents"), better=LOWER),
    Share("collision.excess_rate_controlled", _rate("colliding_beyond_log", "controlled"), better=LOWER),
    "agents with whom the ego has a contact that is not in the log, by nuPlan's attribution: front, stopped track, and "
    "lateral outside one lane are the ego's fault; stopped ego and rear are not",
    Count(
        "collision.ego_at_fault",
        lambda run: sum(contact.contact.ego_at_fault for contact in new_contacts(run)),
        *("contacts at the ego's fault, by nuPlan", "", LOWER),
        sentence=_at_fault_text,
        moments=moments_of(at_fault),
    ),
    Count(
        "collision.background_at_fault",
        lambda run: sum(not contact.contact.ego_at_fault for contact in new_contacts(run)),
    ),
    "contacts that are not in the log, [by who could have avoided them](#who-answers-for-a-contact)",
    _of_fault("background", "contacts, background's fault", Row("background_faults", table=Table.EGO)),
    _of_fault("ego_avoidable", "ego's fault, other could avoid", Row("ego_faults_avoidable")),
    _of_fault("ego_unavoidable", "ego's fault, other could not", Row("ego_faults_unavoidable"), better=Better.NEITHER),
    "pairs that overlap in the log itself; pairs of the run with a contact that is not in the log",
    Count("collision.log_floor", lambda run: len(hits(run).log), "pairs in the log"),
    Count("collision.excess", lambda run: len(hits(run).excess), "pairs not in the log", "", LOWER, rows=EXCESS),
    "number of these pairs with an agent of each kind. Contacts among pedestrians and cyclists are never counted",
    Count("collision.by_kind", _by_kind, keys=tuple(kind.name.lower() for kind in Kind)),
    "each [contact](#contacts) with its first and last step, and whether it is also in the log (`in_log`)",
    Listed("collision.contacts", _all_contacts),
    "for each agent that the ego touched, the first contact that is not in the log, else the first (`in_log`), with "
    "step, verdict and delta-v of the ego (equal masses)",
    Listed("collision.ego_contacts", _ego_contacts, "contacts of the ego", "", LOWER, rows=(Row(table=Table.EGO),)),
    "no contact that is not in the log; no contact at all",
    Truth("reactive", lambda run: not hits(run).excess, "no new contacts", "", HIGHER, rows=REACTIVE),
    Truth("collision_free", lambda run: not hits(run).first, better=HIGHER),
)
ANSWERS = family(
    "contacts that the ego answers for, and the log has not: [the judge](#who-answers-for-a-contact)",
    Count(
        "fault.of_ego",
        lambda run: sum(contact.blame.of_ego for contact in new_contacts(run)),
        *("contacts at the ego's fault", "", LOWER),
        rows=KNOWN_OF_EGO,
        sentence=_answered_text,
        moments=moments_of(answered),
    ),
    "for each contact of the ego: whether it answers for it, `cause`, and who created the situation (`by`); whether "
    "the careful and competent driver of UN R157 in its place avoids it, and from when on that driver perceives it "
    "(reaction 0.75 s, up to 0.774 g with 12.65 m/s³, from a wandering of 0.375 m in the next lane or a time to "
    "collision of 2 s on; the regulation's 0.4 s of evaluating the risk are left out, which is stricter); and as "
    "`other_…` the same in the other's place (null for a pedestrian or a cyclist)",
    Listed("fault.contacts", _answers),
)
