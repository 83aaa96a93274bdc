"""Moments of recorded traffic in which a vehicle may have had to react to another, by the lanes of a net."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from litsim_data.encounters.following import FollowingTrack
from litsim_data.encounters.lack import Lack
from litsim_data.encounters.leader_brakes import brakings
from litsim_data.mining.events import Event, EventKind, Situation
from litsim_data.mining.junction_events import encounters as junction_encounters
from litsim_data.mining.lane_events import cut_ins, lane_merges
from litsim_data.mining.lane_tracks import NOWHERE, runs
from litsim_sim.core.scene import STEP_S
from litsim_sim.scenario.encounter_note import EncounterKind

LATEST, EARLIEST, EVERY = 10, 60, 5
"""Steps before a vehicle is where another was before, among which the onset is searched for."""
FOLLOWED: tuple[EncounterKind, ...] = ("leader_brakes", "standing")
"""Kinds in which the opponent is the leader of the agent, within a headway that matters."""
TURNS = (EventKind.LEFT_TURN, EventKind.RIGHT_TURN)


@dataclass(frozen=True)
class Moment:
    """What may be an encounter.

    Attributes:
        kind: what the opponent did.
        agent, opponent: rows in the log of who had to react, and of whom it had to react to.
        onsets: steps at which it may have begun, the best first.
        lack: why it makes no encounter, if that is known.
    """

    kind: EncounterKind
    agent: int
    opponent: int
    onsets: tuple[int, ...]
    lack: Lack | None = None

    @property
    def rows(self) -> list[int]:
        """The rows of both."""
        return [self.agent, self.opponent]


def moments(situation: Situation) -> Iterator[Moment]:
    """Yields the moments of all kinds."""
    yield from _behind_leaders(situation)
    merges = [event for event in lane_merges(situation) if event.numbers.get("role") == "merged ahead of"]
    merged = {(event.ego, event.other, event.step) for event in merges}
    yield from (_beside(situation, "merge", event) for event in merges)
    for event in cut_ins(situation):
        if (event.ego, event.other, event.step) not in merged:
            yield _beside(situation, "cut_in", event)
    for event in junction_encounters(situation):
        if event.numbers["first"] == "other":
            yield _at_junction(situation, event)


def _behind_leaders(situation: Situation) -> Iterator[Moment]:
    """Yields leaders that brake or come to a stand, as :func:`.leader_brakes.brakings` finds them."""
    log, leader = situation.log, situation.following.leader
    for row in range(len(log.ids)):
        for begin, end in runs(leader[row]):
            ahead = int(leader[row, begin])
            if ahead == NOWHERE:
                continue
            for braking in brakings(_following(situation, row, ahead, slice(begin, end))):
                onset = begin + braking.onset
                yield Moment(braking.kind, row, ahead, (onset,), braking.lack)


def _following(situation: Situation, row: int, ahead: int, part: slice) -> FollowingTrack:
    """Returns how the vehicle in `row` follows that in row `ahead` in a `part` of the steps.

    Places are the integrals of speeds along lanes: gaps along lanes jump where lanes do not fit each other.
    """
    log, speed = situation.log, {vehicle: situation.tracks.along[vehicle, part] for vehicle in (row, ahead)}
    way = {vehicle: np.append(0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))) for vehicle, v in speed.items()}
    return FollowingTrack(
        site="",
        period=0,
        follower=int(log.ids[row]),
        leader=int(log.ids[ahead]),
        leader_length=float(log.length[ahead]),
        first_frame=part.start,
        front=way[row],
        speed=speed[row],
        leader_rear=situation.following.gap[row, part.start] + way[ahead],
        leader_speed=speed[ahead],
    )


def _beside(situation: Situation, kind: EncounterKind, event: Event) -> Moment:
    """Returns the moment of a vehicle that comes into the lane of another."""
    return Moment(kind, *_rows(situation, event), (event.begin,))


def _at_junction(situation: Situation, event: Event) -> Moment:
    """Returns the moment of a vehicle that uses a place of a junction before another."""
    agent, opponent = _rows(situation, event)
    kind: EncounterKind = "crossing"
    if event.kind == EventKind.MERGE:
        kind = "merge"
    elif event.kind in TURNS and event.numbers["other_way"] != "straight":
        kind = "turning"
    onsets = range(event.step - LATEST, max(event.step - EARLIEST, -1), -EVERY)
    return Moment(kind, agent, opponent, tuple(onsets))


def _rows(situation: Situation, event: Event) -> tuple[int, int]:
    """Returns the rows of the ego of an event, which is the agent of an encounter, and of the other vehicle."""
    assert event.other is not None
    return situation.log.row(event.ego), situation.log.row(event.other)
