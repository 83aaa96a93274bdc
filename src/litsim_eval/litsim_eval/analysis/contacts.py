"""Contacts as intervals: which pairs of boxes overlap, from which step to which, and whether the log excuses it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from litsim_sim.core.scene import AgentTable
from litsim_sim.core.steps import Steps
from litsim_sim.record.run import Run

TOLERANCE_S = 1.0
"""Time [s] between overlaps of a pair up to which they are one contact, or up to which one in the log excuses one."""

Pair = tuple[int, int]
"""Ids of two agents, the smaller one first."""


@dataclass(frozen=True)
class Contact:
    """An overlap of two boxes; interruptions of up to TOLERANCE_S do not end it.

    Attributes:
        pair: ids of the agents.
        first, last: first and last step of the overlap.
    """

    pair: Pair
    first: int
    last: int


def contacts(tables: Iterable[AgentTable], dt: float) -> list[Contact]:
    """The contacts in `tables`, ascending steps of `dt` [s], sorted by first step.

    Touching edges do not count, nor do contacts among pedestrians and cyclists, which always follow the recording.
    """
    return list(Steps.of(tables).once(_contacts_in, dt))


class LogContacts:
    """The contacts in the log of a run, history included; they excuse contacts of the run.

    Attributes:
        first: first step after the history at which the boxes of each pair of logged agents overlap, the ego's logged
            trajectory included.
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
        self._lags: dict[int, list[tuple[int, int]]] = {}  # by agent: (step, lag from then on)
        for step in sorted(run.takeovers):
            for each in run.takeovers[step]:
                self._lags.setdefault(each.agent, []).append((step, round(each.time_shift / run.info.dt)))

    def excuse(self, contact: Contact) -> bool:
        """Whether the log has a contact of the pair at about that time, with or without the lag of either log."""
        shifts = {0, *(self._lag(agent, contact.first) for agent in contact.pair)}
        logged: Sequence[Contact] = self._by_pair.get(contact.pair, ())
        first, last = contact.first - self._tolerance, contact.last + self._tolerance
        return any(each.first <= last - shift and first - shift <= each.last for shift in shifts for each in logged)

    def _lag(self, agent: int, step: int) -> int:
        """Lag [steps] of the log of `agent` at `step`, as left by its last takeover until then."""
        return next((lag for at, lag in reversed(self._lags.get(agent, [])) if at <= step), 0)


def _overlaps(steps: Steps) -> list[tuple[int, Pair]]:
    """Step and ids of each pair of overlapping boxes, except where both are pedestrians or cyclists."""
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
