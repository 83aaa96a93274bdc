"""Contacts by fault: who caused them, and whether a careful driver in the ego's or in the other's place helps it."""

from __future__ import annotations

from dataclasses import dataclass

from litsim_sim.analysis.careful_driver import CarefulDriver, careful_driver
from litsim_sim.analysis.collision import Collisions, EgoContact
from litsim_sim.analysis.lanes import lane_map_of
from litsim_sim.record.run import Run


@dataclass(frozen=True)
class ContactVerdict:
    """One contact of the ego, with the careful driver in both places, one after the other.

    Attributes:
        contact: with nuPlan's attribution.
        in_log: whether the log has it as well, so that nobody in the run is to blame.
        own: the driver in the ego's place.
        other: the driver in the other's place; None where that is a pedestrian or a cyclist, whom nobody drives.
    """

    contact: EgoContact
    in_log: bool
    own: CarefulDriver
    other: CarefulDriver | None


@dataclass(frozen=True)
class FaultCounts:
    """Pairs of agents with contacts that the log has not, by who could have helped them.

    Attributes:
        background: a background agent is at fault: it ran into the ego, or into another background agent.
        ego_avoidable: the ego is at fault, and the careful driver in the other's place would have stayed free of it.
        ego_unavoidable: the ego is at fault, and that driver could not have helped it either.
    """

    background: int
    ego_avoidable: int
    ego_unavoidable: int


def contact_verdicts(run: Run, hits: Collisions) -> list[ContactVerdict]:
    """The contacts of the ego in the order of `hits`, the collisions of `run`, each with its verdicts."""
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


def count_faults(run: Run, hits: Collisions, verdicts: list[ContactVerdict]) -> FaultCounts:
    """Count the contacts in `hits` that the log has not, by fault; `verdicts` as :func:`contact_verdicts` gives them.

    Contacts between two background agents are always the background's.
    """
    among = sum(run.info.ego_id not in pair for pair in hits.excess)
    new = [each for each in verdicts if not each.in_log]
    ego = [each for each in new if each.contact.ego_at_fault]
    avoidable = sum(each.other is not None and each.other.avoided for each in ego)
    return FaultCounts(among + len(new) - len(ego), avoidable, len(ego) - avoidable)


def _driver(run: Run, driver: int, agent: int, step: int) -> CarefulDriver:
    return careful_driver(run.simulated, driver, agent, step, run.info.dt, lane_map_of(run))


def _walks(run: Run, contact: EgoContact) -> bool:
    table = next(each for each in run.simulated if each.step == contact.step)
    return bool(table.obstacle[table.row(contact.agent)])
