"""Events at junctions: turns, crossing and merging paths, and turns across oncoming traffic."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from litsim_data.mining.events import Event, EventKind, Number, Situation, severity
from litsim_data.mining.lane_tracks import NOWHERE, TURN_RAD
from litsim_data.mining.passages import MARGIN, Passage, boxes
from litsim_data.mining.signals import Protection, Way
from litsim_data.surrogates.encroachment import PET_HORIZON_S, closest_use
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S

TURN_PET_S = 3.0  # [s] largest post-encroachment time of a turn across oncoming traffic


def turn_events(situation: Situation) -> Iterator[Event]:
    """Yields turns of the ego by more than 45 degrees at more than 5 degrees per second."""
    for turn in situation.turns:
        most = turn.lateral_acceleration
        numbers: dict[str, Number] = {
            "angle_rad": turn.angle,
            "to": "left" if turn.angle > 0.0 else "right",
            "lateral_acceleration_mps2": most,
        }
        steps = turn.begin, (turn.begin + turn.end) // 2, turn.end
        size = severity(lateral_acceleration=most)
        yield situation.event(EventKind.TURN, turn.agent, NOWHERE, steps, size, numbers)


def encounters(situation: Situation) -> Iterator[Event]:
    """Yields events: two vehicles that enter a junction from two roads use one place of it within 5 s of each other.

    Left turn: one turns left across the path of an oncoming vehicle that goes straight, within 3 s, without a protected
    signal. Right turn: the same to the right, where traffic keeps to the left. Merge: they leave in the same lane.
    Crossing: all others. Each gives one event per vehicle, with its role.
    """
    by_junction: dict[str, list[Passage]] = {}
    for passage in situation.passages:
        by_junction.setdefault(passage.junction, []).append(passage)
    for _, inside in sorted(by_junction.items()):
        for a, b in combinations(inside, 2):
            roads = {situation.lane_map.lanes[passage.from_lane].edge_id for passage in (a, b)}
            apart = max(a.first - b.last, b.first - a.last) - 2 * MARGIN
            if a.agent != b.agent and len(roads) == 2 and apart * STEP_S <= PET_HORIZON_S:
                yield from _encounter(situation, a, b)


def _encounter(situation: Situation, a: Passage, b: Passage) -> Iterator[Event]:
    log, inside, ways = situation.log, [], []
    for passage in (a, b):  # with the approach and the exit
        first = max(passage.first - MARGIN, int(log.first_step[passage.agent]))
        last = min(passage.last + MARGIN, int(log.last_step[passage.agent]))
        inside.append(np.arange(first, last + 1))
        ways.append(boxes(log, passage.agent, first, last))
    use = closest_use(inside[0], ways[0], inside[1], ways[1])
    if use is None:
        return
    i, j, apart = use
    step = int(max(inside[0][i], inside[1][j]))
    pet, earlier = apart * STEP_S, a if inside[0][i] < inside[1][j] else b
    angle = float(np.abs(wrap_angle(np.asarray(ways[1][j, 2] - ways[0][i, 2]))))
    kind, signal = _kind(situation, a, b, pet)
    size = severity(pet=pet)
    for own, other in ((a, b), (b, a)):
        numbers: dict[str, Number] = {
            "pet_s": pet,
            "first": "ego" if own is earlier else "other",
            "angle_rad": angle,
            "speed_mps": _speed(situation, own.agent, step),
            "other_speed_mps": _speed(situation, other.agent, step),
            "way": own.way,
            "other_way": other.way,
        }
        if signal is not None:
            numbers |= {"role": "oncoming" if own.way == "straight" else "turning", "signal": str(signal)}
        steps = min(own.first, step), step, max(own.last, step)
        yield situation.event(kind, own.agent, other.agent, steps, size, numbers)


def _speed(situation: Situation, row: int, step: int) -> float | None:
    """Returns the speed [m/s] of the agent in `row` at `step`; None if it is not on the road."""
    return float(situation.log.speed[row, step]) if situation.log.valid[row, step] else None


def _kind(situation: Situation, a: Passage, b: Passage, pet: float) -> tuple[EventKind, Protection | None]:
    """Returns the kind of an encounter with post-encroachment time `pet` [s], and the protection of one that turns."""
    if a.to_lane == b.to_lane:
        return EventKind.MERGE, None
    for turning, straight in ((a, b), (b, a)):
        opposite = np.pi - abs(float(wrap_angle(np.asarray(turning.heading - straight.heading)))) <= TURN_RAD
        if turning.way != "straight" and straight.way == "straight" and opposite and pet <= TURN_PET_S:
            ways = _lanes(situation, turning), _lanes(situation, straight)
            signal = situation.signals.protection(*ways, turning.first)
            if signal != Protection.PROTECTED:
                return EventKind.LEFT_TURN if turning.way == "left" else EventKind.RIGHT_TURN, signal
    return EventKind.CROSSING, None


def _lanes(situation: Situation, passage: Passage) -> Way:
    lanes = situation.lane_map.lanes
    return lanes[passage.from_lane].id, lanes[passage.to_lane].id
