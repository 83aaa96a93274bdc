"""Contacts by fault: which agent is at fault, and whether a careful driver in place of either would have avoided it."""

from __future__ import annotations

from dataclasses import dataclass

from litsim_eval.analysis.careful_driver import CarefulDriver, careful_driver
from litsim_eval.analysis.collision import Collisions, EgoContact
from litsim_eval.analysis.metrics_tree import FaultMetrics
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run


@dataclass(frozen=True)
class ContactVerdict:
    """One contact of the ego, with the verdicts of the careful driver in place of the ego and of the other agent.

    Attributes:
        contact: the contact, with nuPlan's attribution.
        in_log: whether the log contains it too; then no agent of the run is at fault.
        own: verdict on the driver in place of the ego.
        other: verdict on the driver in place of the other agent; None if that is a pedestrian or a cyclist.
    """

    contact: EgoContact
    in_log: bool
    own: CarefulDriver
    other: CarefulDriver | None


def contact_verdicts(run: Run, hits: Collisions) -> list[ContactVerdict]:
    """Returns verdicts on the ego's contacts, in the order of `hits`, the collisions of `run`."""
    ego = run.info.ego_id
    return [
        ContactVerdict(
            contact,
            (min(ego, contact.agent), max(ego, contact.agent)) not in hits.excess,
            _driver(run, ego, contact.agent, contact.step),
            None if _walks(run, contact) else _driver(run, contact.agent, ego, contact.step),
        )
        for contact in hits.ego
    ]


def count_faults(run: Run, hits: Collisions, verdicts: list[ContactVerdict]) -> FaultMetrics:
    """Counts pairs of agents with contacts of `hits` that are not in the log, by fault; `verdicts` as returned above.

    A contact between two background agents is always the fault of the background. A contact at the fault of the ego is
    avoidable if the careful driver in place of the other agent would have avoided it.
    """
    among = sum(run.info.ego_id not in pair for pair in hits.excess)
    new = [each for each in verdicts if not each.in_log]
    ego = [each for each in new if each.contact.ego_at_fault]
    avoidable = sum(each.other is not None and each.other.avoided for each in ego)
    return {
        "background": among + len(new) - len(ego),
        "ego_avoidable": avoidable,
        "ego_unavoidable": len(ego) - avoidable,
    }


def _driver(run: Run, driver: int, agent: int, step: int) -> CarefulDriver:
    return careful_driver(run.simulated, driver, agent, step, run.info.dt, lane_map_of(run))


def _walks(run: Run, contact: EgoContact) -> bool:
    table = run.steps[int(run.steps.step.searchsorted(contact.step))]
    return bool(table.obstacle[table.row(contact.agent)])
