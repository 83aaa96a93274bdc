"""People's car following as scenarios of a training: all that is recorded of it, but for vehicles of reported results.

Every track of the tuning part (:mod:`litsim_data.encounters.split`) is cut into parts of at most 20 s on a straight
road; the ego is the leader. Every tenth vehicle is for validation.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from litsim_data.encounters.following import FollowingTrack, following_tracks
from litsim_data.encounters.leader_brakes import JUMP, ROOM
from litsim_data.encounters.packaged import rows
from litsim_data.encounters.smoothing import centred_place
from litsim_data.encounters.split import WINDOWS_SITES
from litsim_data.encounters.straight_road import following_scenario
from litsim_sim.scenario.scenario import Scenario

HISTORY = 11  # steps
LONGEST, SHORTEST = 211, 71  # frames of a part
GAP_MAX = 40.0  # [m] at the end of the history; drivers farther behind hardly react
VALIDATED = 10  # one in so many vehicles is for validation


def following_scenarios(data: Path) -> tuple[list[Scenario], list[Scenario]]:
    """Returns the scenarios for training and those for validation, from the files below `data` (LITSIM_DATA).

    Raises:
        InputError: a file is missing, or lacks a column.
    """
    train: list[Scenario] = []
    validation: list[Scenario] = []
    vehicles: dict[tuple[str, int, int], int] = {}
    for track in following_tracks(data):
        if track.split == "tuning":
            number = vehicles.setdefault((track.site, track.period, track.follower), len(vehicles))
            into = validation if number % VALIDATED == VALIDATED - 1 else train
            into += [following_scenario(track, part, HISTORY) for part in _parts(track)]
    return train, validation


def reported_drivers() -> frozenset[int]:
    """Returns NGSIM's ids of the vehicles of the US-101 windows whose reactions are reported on."""
    reported = (row for row in rows("reported") if row.site in WINDOWS_SITES and row.period == 0)
    return frozenset(row.agent for row in reported)


def _parts(track: FollowingTrack) -> Iterator[slice]:
    """Yields the parts of a track without jumps of the record, in which the follower is near."""
    rear, front = centred_place(track.leader_rear), centred_place(track.front)
    jumps = np.maximum(np.abs(rear - track.leader_rear), np.abs(front - track.front))
    gap = rear - front
    for begin in range(0, len(track) - SHORTEST + 1, LONGEST):
        part = slice(begin, min(begin + LONGEST, len(track)))
        if jumps[part].max() <= JUMP and gap[part].min() >= ROOM and gap[begin + HISTORY] <= GAP_MAX:
            yield part
