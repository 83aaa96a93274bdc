"""Selection of events: the most severe, or an even spread; each ego counts once for a kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from litsim_data.mining.events import Event, EventKind


@dataclass(frozen=True)
class Found:
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


def hardest(found: Sequence[Found], count: int) -> list[Found]:
    """The `count` most severe of `found`, in descending order; ties in the order of `found`."""
    return sorted(found, key=lambda each: -each.event.severity)[:count]


def spread(found: Sequence[Found], count: int) -> list[Found]:
    """`count` of `found` with severities spread as evenly as possible over their range.

    For each of `count` evenly spaced severities, in descending order, the nearest event that is left.
    """
    left = hardest(found, len(found))
    if len(left) <= count:
        return left
    taken = []
    for target in np.linspace(left[0].event.severity, left[-1].event.severity, count):
        nearest = min(range(len(left)), key=lambda at: (abs(left[at].event.severity - target), at))
        taken.append(left.pop(nearest))
    return taken


def worst_of_each(found: Iterable[Found]) -> list[Found]:
    """The most severe event of every scenario and ego, the first of ties; in the order of `found`."""
    best: dict[tuple[str, int], Found] = {}
    for each in found:
        if each.seat not in best or each.event.severity > best[each.seat].event.severity:
            best[each.seat] = each
    return list(best.values())


def choose(found: Sequence[Found], wanted: Mapping[EventKind, int | None], *, evenly: bool = False) -> list[Chosen]:
    """Cases for each kind of `wanted`, as many as it says (None: all), the most severe or `evenly` spread.

    An ego counts once for a kind, with its most severe event; one chosen for several kinds is one case. Deterministic;
    in the order of `found`.
    """
    pick = spread if evenly else hardest
    chosen: dict[tuple[str, int], list[Event]] = {}
    for kind, count in wanted.items():
        candidates = worst_of_each(each for each in found if each.event.kind == kind)
        for each in pick(candidates, len(candidates) if count is None else count):
            chosen.setdefault(each.seat, []).append(each.event)
    around: dict[tuple[str, int], list[Event]] = {}
    for each in found:
        around.setdefault(each.seat, []).append(each.event)
    return [_case(seat, chosen[seat], events) for seat, events in around.items() if seat in chosen]


def _case(seat: tuple[str, int], why: list[Event], events: list[Event]) -> Chosen:
    first = sorted(why, key=lambda event: (event.step, event.kind))
    rest = [event for event in events if event not in why]
    return Chosen(*seat, tuple(event.kind for event in first), (*first, *rest))
