"""Events along a lane: a braking leader, stop and go, and steady following."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from litsim_data.mining.events import HEADWAY_MAX_S, Event, EventKind, Number, Situation, measured, severity
from litsim_data.mining.lane_tracks import NOWHERE, true_runs
from litsim_sim.core.scene import STEP_S, BoolArray

HARD_MPS2, HARD_S, LOST_MPS = -3.0, 0.6, 1.0  # hard braking: acceleration, shortest duration, smallest loss of speed
LEADER_MPS2 = -2.5  # largest acceleration of a braking leader
AFTER = round(3.0 / STEP_S)  # steps after braking in which the shortest TTC is searched for
FULL_BRAKING = 7.59  # [m/s2] 0.774 g, of UN Regulation 157's careful driver: brake threat number 1

GOING, STOPPED = 5.0, 2.0  # [m/s] speeds above and below which an ego moves and is stopped; our choice
QUEUE_M = 30.0  # [m] largest gap to the leader in a queue; our choice

FOLLOWING_HEADWAY_S, FOLLOWING_SPEED, FOLLOWING_TTC_S, FOLLOWING_S = (0.7, 3.0), 3.0, 3.0, 2.0


def hard_braking(situation: Situation) -> Iterator[Event]:
    """Yields events: the leader brakes at 3 m/s2 or more for at least 0.6 s and loses at least 1 m/s."""
    speed = situation.log.speed
    for row, begin, end in _decelerations(situation, HARD_MPS2):
        lasts = (end - begin) * STEP_S >= HARD_S - 1e-9
        if lasts and float(speed[row, begin] - speed[row, end - 1]) >= LOST_MPS:
            yield from _braking(situation, row, begin, end - 1, EventKind.HARD_BRAKING)


def leader_braking(situation: Situation) -> Iterator[Event]:
    """Yields events in which the leader, within a headway of 3.5 s, brakes at 2.5 m/s2 or more."""
    for row, begin, end in _decelerations(situation, LEADER_MPS2):
        yield from _braking(situation, row, begin, end - 1, EventKind.LEADER_BRAKING)


def _decelerations(situation: Situation, most: float) -> Iterator[tuple[int, int, int]]:
    """Yields row, first step and end (exclusive) of each run of accelerations of at most `most` [m/s2]."""
    log = situation.log
    for row in range(len(log.ids)):
        for begin, end in true_runs(log.valid[row] & (log.acceleration[row] <= most)):
            yield row, begin, end


def stop_and_go(situation: Situation) -> Iterator[Event]:
    """Yields events: an ego slows from 5 m/s to below 2 m/s within 30 m behind its leader, and gets back to 5 m/s."""
    log, following = situation.log, situation.following
    for row in range(len(log.ids)):
        speed, there = log.speed[row], log.valid[row]
        going = np.flatnonzero(there & (speed >= GOING))
        for before, after in pairwise(going):
            slow = np.flatnonzero(speed[before:after] < STOPPED) + before
            queued = following.gap[row, slow] <= QUEUE_M
            if not len(slow) or not queued.any():
                continue
            worst = situation.ttc_min(row, int(before), int(after))
            headway = float(following.headway[row, before : after + 1][speed[before : after + 1] >= STOPPED].min())
            braking = float(log.acceleration[row, before : after + 1].min())
            numbers: dict[str, Number] = {
                "speed_min_mps": measured(speed[slow].min()),
                "stopped_s": measured(len(slow) * STEP_S),
                "gap_min_m": measured(following.gap[row, before : after + 1].min()),
                "headway_min_s": measured(headway),
                "ttc_min_s": measured(worst),
                "acceleration_min_mps2": measured(braking),
            }
            step = int(slow[0])
            leader = int(following.leader[row, slow[int(np.argmax(queued))]])
            size = severity(ttc=worst, headway=headway)
            ego, other = situation.id_of(row), situation.id_of(leader)
            yield Event(EventKind.STOP_AND_GO, ego, other, int(before), step, int(after), size, numbers)


def steady_following(situation: Situation) -> Iterator[Event]:
    """Yields events: an ego follows a leader for 2 s: headway 0.7 to 3 s, closing speed within 3 m/s, TTC above 3 s."""
    following = situation.following
    low, high = FOLLOWING_HEADWAY_S
    steady: BoolArray = (following.headway >= low) & (following.headway <= high)
    steady &= (np.abs(following.closing) <= FOLLOWING_SPEED) & (following.time_to_leader > FOLLOWING_TTC_S)
    for row in range(len(situation.log.ids)):
        leader = following.leader[row]
        for other in np.unique(leader[leader != NOWHERE]).tolist():
            for begin, end in true_runs(steady[row] & (leader == other)):
                if (end - begin) * STEP_S < FOLLOWING_S - 1e-9:
                    continue
                headway = following.headway[row, begin:end]
                at = begin + int(headway.argmin())
                numbers: dict[str, Number] = {
                    "duration_s": measured((end - begin) * STEP_S),
                    "headway_s": measured(headway.min()),
                    "gap_m": measured(following.gap[row, at]),
                    "closing_mps": measured(following.closing[row, at]),
                }
                size = severity(headway=float(headway.min()))
                ids = situation.id_of(row), situation.id_of(other)
                yield Event(EventKind.FOLLOWING, *ids, begin, at, end - 1, size, numbers)


def _braking(situation: Situation, row: int, begin: int, end: int, kind: EventKind) -> Iterator[Event]:
    """Yields events of the agent in `row` braking from step `begin` to `end`, one for each of its followers."""
    log, following = situation.log, situation.following
    piece = slice(begin, end + 1)
    concerned = (following.leader[:, piece] == row) & (following.headway[:, piece] < HEADWAY_MAX_S)
    for ego in np.flatnonzero(concerned.any(axis=1)).tolist():
        step = begin + int(np.argmax(concerned[ego]))
        gap, closing = float(following.gap[ego, step]), float(following.closing[ego, step])
        strongest = float(log.acceleration[row, piece].min())
        threat = brake_threat(gap, float(log.speed[ego, step]), float(log.speed[row, step]), -strongest)
        headway, later = float(following.headway[ego, step]), min(end + AFTER, int(log.last_step[ego]))
        ttc_min = situation.ttc_min(ego, step, later)
        numbers: dict[str, Number] = {
            "acceleration_min_mps2": measured(strongest),
            "speed_lost_mps": measured(log.speed[row, begin] - log.speed[row, end]),
            "gap_m": measured(gap),
            "closing_mps": measured(closing),
            "headway_s": measured(headway),
            "ttc_min_s": measured(ttc_min),
            "brake_threat": measured(threat),
        }
        size = severity(ttc=ttc_min, headway=headway, brake_threat=threat)
        yield Event(kind, situation.id_of(ego), situation.id_of(row), begin, step, end, size, numbers)


def brake_threat(gap: float, speed: float, leader_speed: float, leader_braking: float) -> float:
    """Returns the share of full braking, 0.774 g, that an ego needs behind a leader that brakes to a stop.

    Above 1 braking cannot avoid a contact, even without reaction time; inf without any room. After Brannstrom, Sjoberg
    and Coelingh (2008), for a leader that keeps braking.

    Args:
        gap: bumper-to-bumper distance [m].
        speed, leader_speed: speeds of ego and leader [m/s].
        leader_braking: deceleration of the leader [m/s2], greater than 0.
    """
    room = gap + leader_speed**2 / (2.0 * leader_braking)
    if speed <= 0.0:
        return 0.0
    return float("inf") if room <= 0.0 else speed**2 / (2.0 * room) / FULL_BRAKING
