"""Encounters of recorded car following as scenarios, on a straight road of one lane.

What can be seen looks at no later sample: the log has the follower where it was recorded, with the speeds of
:mod:`.following`, and the ego drives a :func:`.smoothing.drivable` motion of its leader. What the follower truly did is
in :func:`.smoothing.centred_place`.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.following import CAR_LENGTH, FollowingTrack
from litsim_data.encounters.leader_brakes import AFTER, Braking
from litsim_data.encounters.origin import Origin
from litsim_data.encounters.smoothing import centred_place, centred_speed, drivable
from litsim_sim.core.scene import STEP_S, FloatArray, Kind
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.encounter_note import EncounterNote, Track, TrackNote, Truth
from litsim_sim.scenario.scenario import Scenario

WIDTH = 1.9  # [m] of all vehicles
UNKNOWN_LEADER = 0  # id of a leader whose NGSIM id is not known; those begin at 1
ACCELERATION_STEPS = 5  # back to the speed from which an acceleration is measured
DATA = {"i80": "NGSIM I-80, 2005-04-13", "us101": "NGSIM US-101, 2005-06-15"}
PUBLISHED = "US DOT / FHWA, doi 10.21949/1504477"
LICENCE = "CC BY-SA"


def encounter(braking: Braking) -> Encounter:
    """Returns the encounter of a `braking` leader without a lack."""
    track, onset = braking.track, braking.history
    part, half = slice(braking.onset - onset, braking.onset + AFTER + 1), 0.5 * CAR_LENGTH
    opponent = _straight(*drivable(track.leader_rear[part] + 0.5 * track.leader_length, track.leader_speed[part]))
    agent = _driven(track.front, part, -half)
    note = EncounterNote(
        kind=braking.kind,
        site=track.site,
        agent=track.follower,
        opponent=_leader(track),
        onset_step=onset,
        split=track.split,
        truth=Truth(agent=TrackNote.of(agent), opponent=TrackNote.of(opponent)),
    )
    seen = _straight(track.front[part] - half, track.speed[part])
    frame = braking.frame - onset
    both = _columns(track, frame, _at_pace(opponent, onset), _at_pace(seen, onset))
    return _origin(track.site).encounter(braking.name, note, both)


def following_scenario(track: FollowingTrack, part: slice, history: int) -> Scenario:
    """Returns a `part` of recorded car following as a scenario, whose log has both vehicles as they truly drove.

    The ego is the leader; it is free from step `history` on.
    """
    frame, ahead = track.first_frame + part.start, _driven(track.leader_rear, part, 0.5 * track.leader_length)
    both = _columns(track, frame, ahead, _driven(track.front, part, -0.5 * CAR_LENGTH))
    name = f"{track.site}_{track.period}_{track.follower}_{frame}"
    return _origin(track.site).scenario(name, both, ego=_leader(track), history_steps=history)


def _leader(track: FollowingTrack) -> int:
    """Returns the id of the leader."""
    return max(track.leader, UNKNOWN_LEADER)


def _driven(end: FloatArray, part: slice, ahead: float) -> Track:
    """Returns how a vehicle truly drove in a `part` of its record; its middle is `ahead` [m] of its `end` (T,) [m]."""
    return _straight(centred_place(end)[part] + ahead, centred_speed(end)[part])


def _straight(x: FloatArray, speed: FloatArray) -> Track:
    return Track(x, np.zeros(len(x)), np.zeros(len(x)), speed)


def _at_pace(track: Track, onset: int) -> Track:
    """Returns a straight `track` that keeps its speed from step `onset` on."""
    step = np.arange(len(track))
    kept = np.minimum(step, onset)
    return _straight(track.x[kept] + STEP_S * (step - kept) * track.speed[onset], track.speed[kept])


def _columns(track: FollowingTrack, frame: int, leader: Track, follower: Track) -> dict[str, np.ndarray]:
    """Returns the columns of a recording of both vehicles that begins at `frame`."""
    both = (_leader(track), leader, track.leader_length), (track.follower, follower, CAR_LENGTH)
    columns = [_columns_of(vehicle, frame, driven, length) for vehicle, driven, length in both]
    return {name: np.concatenate([column[name] for column in columns]) for name in columns[0]}


def _columns_of(vehicle: int, frame: int, track: Track, length: float) -> dict[str, np.ndarray]:
    """Returns the columns of one `vehicle` of a `length` [m]."""
    step = np.arange(len(track))
    before = track.speed[np.maximum(step - ACCELERATION_STEPS, 0)]
    values: dict[str, Any] = {
        "vehicle_id": vehicle,
        "frame": frame + step,
        **vars(track),
        "acceleration": (track.speed - before) / (ACCELERATION_STEPS * STEP_S),
        "length": length,
        "width": WIDTH,
        "kind": int(Kind.CAR),
        "lane": 1,
    }
    return {name: np.broadcast_to(value, len(track)) for name, value in values.items()}


@cache
def _origin(site: str) -> Origin:
    net = Path(str(resources.files("litsim_data.encounters").joinpath("road.net.xml")))
    return Origin(f"{DATA[site]} ({PUBLISHED})", LICENCE, net, LaneMap.from_net(net))
