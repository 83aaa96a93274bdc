"""Selection of events: the most severe, or an even spread; each ego counts once for a kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from litsim_data.mining.events import Event, EventKind


@dataclass(frozen=True)
class MinedEvent:
    """An event and the scenario that it was found in.

    Attributes:
        scenario: name or path, as the scenario was given.
        event: the event.
    """

    scenario: str
    event: Event

    @property
    def seat(self) -> tuple[str, int]:
        """Its scenario and ego."""
        return self.scenario, self.event.ego


@dataclass(frozen=True)
class Chosen:
    """A case of a suite: a scenario and an ego, and the events that it was chosen for.

    Attributes:
        scenario, ego: name or path of the scenario, and id of the ego.
        kinds: kinds of the events that it was chosen for.
        events: the events that it was chosen for, by time, then the other events around the ego.
    """

    scenario: str
    ego: int
    kinds: tuple[EventKind, ...]
    events: tuple[Event, ...]


def hardest(events: Sequence[MinedEvent], count: int) -> list[MinedEvent]:
    """Returns the `count` most severe of `events`, in descending order; ties in the order of `events`."""
    return sorted(events, key=lambda seated: -seated.event.severity)[:count]


def spread(events: Sequence[MinedEvent], count: int) -> list[MinedEvent]:
    """Returns `count` of `events` with severities spread as evenly as possible over their range.

    For each of `count` evenly spaced severities, in descending order, the nearest event that is left.
    """
    left = hardest(events, len(events))
    if len(left) <= count:
        return left
    chosen = []
    for target in np.linspace(left[0].event.severity, left[-1].event.severity, count):
        nearest = min(range(len(left)), key=lambda index: (abs(left[index].event.severity - target), index))
        chosen.append(left.pop(nearest))
    return chosen


def worst_of_each(events: Iterable[MinedEvent]) -> list[MinedEvent]:
    """Returns the most severe event of every scenario and ego, the first of ties; in the order of `events`."""
    best: dict[tuple[str, int], MinedEvent] = {}
    for seated in events:
        if seated.seat not in best or seated.event.severity > best[seated.seat].event.severity:
            best[seated.seat] = seated
    return list(best.values())


def choose(
    events: Sequence[MinedEvent], wanted: Mapping[EventKind, int | None], *, evenly: bool = False
) -> list[Chosen]:
    """Returns cases for each kind of `wanted`, as many as it says (None: all), the most severe or `evenly` spread.

    An ego counts once for a kind, with its most severe event; one chosen for several kinds is one case. Deterministic;
    in the order of `events`.
    """
    pick = spread if evenly else hardest
    chosen: dict[tuple[str, int], list[Event]] = {}
    for kind, count in wanted.items():
        candidates = worst_of_each(seated for seated in events if seated.event.kind == kind)
        for seated in pick(candidates, len(candidates) if count is None else count):
            chosen.setdefault(seated.seat, []).append(seated.event)
    around: dict[tuple[str, int], list[Event]] = {}
    for seated in events:
        around.setdefault(seated.seat, []).append(seated.event)
    cases = []
    for seat, of_seat in around.items():
        if why := sorted(chosen.get(seat, ()), key=lambda event: (event.step, event.kind)):
            rest = (event for event in of_seat if event not in why)
            cases.append(Chosen(*seat, tuple(event.kind for event in why), (*why, *rest)))
    return cases
