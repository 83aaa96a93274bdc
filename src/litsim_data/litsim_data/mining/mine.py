"""Search for the events around every possible ego of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence

import numpy as np

from litsim_data.mining import following_events, junction_events, lane_events
from litsim_data.mining.events import Event, EventKind, Situation
from litsim_data.segments import EGO_KINDS
from litsim_sim.scenario.scenario import Scenario

FINDERS: tuple[tuple[Callable[[Situation], Iterator[Event]], tuple[EventKind, ...]], ...] = (
    (lane_events.cut_ins, (EventKind.CUT_IN,)),
    (lane_events.cut_outs, (EventKind.CUT_OUT,)),
    (lane_events.lane_change_events, (EventKind.LANE_CHANGE,)),
    (lane_events.lane_merges, (EventKind.MERGE,)),
    (following_events.hard_braking, (EventKind.HARD_BRAKING,)),
    (following_events.leader_braking, (EventKind.LEADER_BRAKING,)),
    (following_events.stop_and_go, (EventKind.STOP_AND_GO,)),
    (following_events.steady_following, (EventKind.FOLLOWING,)),
    (junction_events.turn_events, (EventKind.TURN,)),
    (junction_events.encounters, (EventKind.CROSSING, EventKind.LEFT_TURN, EventKind.RIGHT_TURN, EventKind.MERGE)),
)
"""Functions that find events, and the kinds that each finds."""


def events_in(situation: Situation, kinds: Collection[EventKind] = tuple(EventKind)) -> list[Event]:
    """Returns the events of the given kinds around every agent, sorted by ego, time and kind."""
    events = [
        event
        for finder, finds in FINDERS
        if not set(finds).isdisjoint(kinds)
        for event in finder(situation)
        if event.kind in kinds
    ]
    return sorted(events, key=lambda event: (event.ego, event.step, event.kind, event.other or 0))


def mine(scenario: Scenario, kinds: Collection[EventKind] = tuple(EventKind)) -> list[Event]:
    """Returns the events of the given kinds around every possible ego of `scenario`, motorcycles excepted.

    Only events with their step between the end of the history and the end of the scenario count.
    """
    egos = set(possible_egos(scenario))
    return [
        event
        for event in events_in(Situation.of_scenario(scenario), kinds)
        if event.ego in egos and scenario.history_steps <= event.step <= scenario.total_steps
    ]


def possible_egos(scenario: Scenario) -> Sequence[int]:
    """Returns ids of possible egos: present from step 0 to the first simulated one, and not motorcycles."""
    ids = np.array(scenario.possible_egos, np.int64)
    kinds = scenario.log.kind[np.searchsorted(scenario.log.ids, ids)]
    return [int(ego) for ego in ids[np.isin(kinds, EGO_KINDS)]]
