"""Contacts as stretches of time: whose boxes overlapped from when to when, and which of that the log has as well."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from litsim_sim.core.scene import AgentTable
from litsim_sim.core.steps import Steps
from litsim_sim.record.run import Run

TOLERANCE_S = 1.0
"""[s] by which contacts of a pair may be apart and still be one, and a contact from one of the log that excuses it."""

Pair = tuple[int, int]
"""Ids of two agents, the smaller one first."""


@dataclass(frozen=True)
class Contact:
    """Two boxes overlap; interruptions of up to TOLERANCE_S are part of it.

    Attributes:
        pair: the agents.
        first, last: steps, both included.
    """

    pair: Pair
    first: int
    last: int


def contacts(tables: Iterable[AgentTable], dt: float) -> list[Contact]:
    """The contacts in `tables`, steps ascending and `dt` [s] long, by first step; touching edges do not count.

    Nor do contacts among pedestrians and cyclists, who walk side by side as recorded whatever happens.
    """
    return list(Steps.of(tables).once(_contacts_in, dt))


class LogContacts:
    """The contacts that the log of a run has, history included, and which contacts of the run they excuse.

    Attributes:
        first: step after the history at which the boxes of each pair of logged agents overlap for the first time, the
            ego's logged trajectory included.
    """

    def __init__(self, run: Run) -> None:
        self._tolerance = round(TOLERANCE_S / run.info.dt)
        self.first: dict[Pair, int] = {}
        for step, pair in run.logged.once(_overlaps):
            if step > run.info.history_steps:
                self.first.setdefault(pair, step)
        self._by_pair: dict[Pair, list[Contact]] = {}
        for contact in contacts(run.logged, run.info.dt):
            self._by_pair.setdefault(contact.pair, []).append(contact)
        self._lags: dict[int, list[tuple[int, int]]] = {}  # of agents that have any: steps, and lags from then on
        for step in sorted(run.takeovers):
            for each in run.takeovers[step]:
                self._lags.setdefault(each.agent, []).append((step, round(each.time_shift / run.info.dt)))

    def excuse(self, contact: Contact) -> bool:
        """Whether the log has a contact of the same pair at about that time, by the clock or by a log that lags."""
        shifts = {0, *(self._lag(agent, contact.first) for agent in contact.pair)}
        logged: Sequence[Contact] = self._by_pair.get(contact.pair, ())
        first, last = contact.first - self._tolerance, contact.last + self._tolerance
        return any(each.first <= last - shift and first - shift <= each.last for shift in shifts for each in logged)

    def _lag(self, agent: int, step: int) -> int:
        """Steps by which the log of `agent` lags at `step`: as its last takeover up to there has left it."""
        return next((lag for at, lag in reversed(self._lags.get(agent, [])) if at <= step), 0)


def _overlaps(steps: Steps) -> list[tuple[int, Pair]]:
    """Step and ids of each two boxes that overlap and are not both of pedestrians or cyclists."""
    table, pairs = steps.stacked, steps.overlaps
    pairs = pairs[~table.obstacle[pairs].all(axis=1)]
    at = steps.step[table.number[pairs[:, 0]]].tolist()
    return [(step, (i, j)) for step, (i, j) in zip(at, table.id[pairs].tolist(), strict=True)]


def _contacts_in(steps: Steps, dt: float) -> tuple[Contact, ...]:
    """See :func:`contacts`."""
    merge = round(TOLERANCE_S / dt)
    by_pair: dict[Pair, list[list[int]]] = {}
    for step, pair in steps.once(_overlaps):
        found = by_pair.setdefault(pair, [])
        if found and step - found[-1][1] <= merge:
            found[-1][1] = step
        else:
            found.append([step, step])
    every = (Contact(pair, first, last) for pair, found in by_pair.items() for first, last in found)
    return tuple(sorted(every, key=lambda contact: contact.first))
