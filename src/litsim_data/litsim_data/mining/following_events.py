"""Events along a lane: a braking leader, stop and go, and steady following."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from litsim_data.mining.events import HEADWAY_MAX_S, Event, EventKind, Number, Situation, severity
from litsim_data.mining.lane_tracks import NOWHERE, true_runs
from litsim_sim.core.scene import STEP_S, BoolArray

HARD_MPS2, HARD_S, LOST_MPS = -3.0, 0.6, 1.0  # hard braking: acceleration, shortest duration, smallest loss of speed
LEADER_MPS2 = -2.5  # largest acceleration of a braking leader
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
            piece = slice(before, after + 1)
            headway = float(following.headway[row, piece][speed[piece] >= STOPPED].min())
            numbers: dict[str, Number] = {
                "speed_min_mps": speed[slow].min(),
                "stopped_s": len(slow) * STEP_S,
                "gap_min_m": following.gap[row, piece].min(),
                "headway_min_s": headway,
                "ttc_min_s": worst,
                "acceleration_min_mps2": log.acceleration[row, piece].min(),
            }
            leader = int(following.leader[row, slow[int(np.argmax(queued))]])
            steps, size = (int(before), int(slow[0]), int(after)), severity(ttc=worst, headway=headway)
            yield situation.event(EventKind.STOP_AND_GO, row, leader, steps, size, numbers)


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
                worst = begin + int(following.headway[row, begin:end].argmin())
                headway = float(following.headway[row, worst])
                numbers: dict[str, Number] = {
                    "duration_s": (end - begin) * STEP_S,
                    "headway_s": headway,
                    "gap_m": following.gap[row, worst],
                    "closing_mps": following.closing[row, worst],
                }
                steps, size = (begin, worst, end - 1), severity(headway=headway)
                yield situation.event(EventKind.FOLLOWING, row, other, steps, size, numbers)


def _braking(situation: Situation, row: int, begin: int, end: int, kind: EventKind) -> Iterator[Event]:
    """Yields events of the agent in `row` braking from step `begin` to `end`, one for each of its followers."""
    log, following = situation.log, situation.following
    piece = slice(begin, end + 1)
    concerned = (following.leader[:, piece] == row) & (following.headway[:, piece] < HEADWAY_MAX_S)
    for ego in np.flatnonzero(concerned.any(axis=1)).tolist():
        step = begin + int(np.argmax(concerned[ego]))
        gap = float(following.gap[ego, step])
        strongest = float(log.acceleration[row, piece].min())
        threat = brake_threat(gap, float(log.speed[ego, step]), float(log.speed[row, step]), -strongest)
        headway, ttc_min = float(following.headway[ego, step]), situation.ttc_after(ego, step, end)
        numbers: dict[str, Number] = {
            "acceleration_min_mps2": strongest,
            "speed_lost_mps": log.speed[row, begin] - log.speed[row, end],
            "gap_m": gap,
            "closing_mps": following.closing[ego, step],
            "headway_s": headway,
            "ttc_min_s": ttc_min,
            "brake_threat": threat,
        }
        size = severity(ttc=ttc_min, headway=headway, brake_threat=threat)
        yield situation.event(kind, ego, row, (begin, step, end), size, numbers)


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
