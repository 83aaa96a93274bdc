"""Recorded car following on I-80 and US-101: vehicles behind their leaders, along the road.

Three files below LITSIM_DATA hold NGSIM's tracks:

- pairs of I-80, whose publishers have smoothed positions and speeds; both are taken as they are;
- lanes 1 and 7 of I-80, with the id and the front of each vehicle's leader;
- single vehicles of US-101, with the distance from front to front of an unnamed leader.

In the latter two, fronts are taken as recorded. NGSIM's speeds swing by several m/s2, so the speed of a vehicle is a
:func:`.smoothing.trailing_fit` to its recorded speeds, and that of its leader one to the changes of the leader's
front. Neither looks ahead: at no step does a track depend on later samples of these files.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from litsim_data.encounters.smoothing import trailing_fit
from litsim_data.encounters.split import split_of
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.io.parquet_input import read_table
from litsim_sim.scenario.encounter_note import Split

if TYPE_CHECKING:
    import pandas as pd

PAIRS = "ngsim/i80_car_following_pairs.parquet"
LANES = "ngsim/i80_lanes_1_7_longitudinal.parquet"
VEHICLES = "ngsim/us101_vehicle_tracks.parquet"
"""Files, relative to LITSIM_DATA."""
CAR_LENGTH = 4.7  # [m] of leaders whose length is not recorded: NGSIM's mean of cars
CAR_CLASS = 2  # NGSIM's class of cars; the length of other leaders is not even known roughly
JUMP = 1.0  # [m] by which a leader's front moves otherwise than its follower within a step: another leader
HEADWAY_MAX = 100.0  # [m] between fronts; farther leaders are none
SHORTEST = 40  # frames of a track


@dataclass(frozen=True)
class FollowingTrack:
    """A vehicle behind the same leader; arrays (T,), a frame of 0.1 s each, along the road.

    Attributes:
        site: i80 or us101.
        period: of NGSIM's recording: begin as hhmm (i80), or 0, 1, 2 (us101).
        follower: NGSIM's id of the vehicle.
        leader: that of its leader; -1 if it is not known.
        leader_length: as recorded, or :data:`CAR_LENGTH` [m].
        first_frame: frame of the first sample.
        front: of the follower [m].
        speed: of the follower [m/s].
        leader_rear: rear of the leader [m], always ahead of `front`.
        leader_speed: speed of the leader [m/s].
    """

    site: str
    period: int
    follower: int
    leader: int
    leader_length: float
    first_frame: int
    front: FloatArray
    speed: FloatArray
    leader_rear: FloatArray
    leader_speed: FloatArray

    def __len__(self) -> int:
        return len(self.front)

    @property
    def split(self) -> Split:
        """The part of the follower."""
        return split_of(self.site, self.period, self.follower)

    @property
    def gap(self) -> FloatArray:
        """Distances (T,) from the front of the follower to the rear of its leader [m]."""
        return self.leader_rear - self.front


def following_tracks(data: Path) -> Iterator[FollowingTrack]:
    """Yields the tracks in the files below `data`, in the order of period and vehicle within each file.

    Raises:
        InputError: a file is missing, or lacks a column.
    """
    yield from pairs(data)
    yield from lanes(data)
    yield from vehicles(data)


def pairs(data: Path) -> Iterator[FollowingTrack]:
    """Yields the car-following pairs of I-80; see :func:`following_tracks`."""
    needed = ("period", "pair", "frame", "follower", "follower_y_m", "follower_speed_mps")
    table = read_table(data / PAIRS, (*needed, "leader", "leader_y_m", "leader_speed_mps", "leader_length_m"))
    for _, group in table.sort_values("frame").groupby(["period", "pair"]):
        front, frame = _numbers(group, "follower_y_m"), group["frame"].to_numpy()
        rear = _numbers(group, "leader_y_m") - _numbers(group, "leader_length_m")
        for run in _runs(frame, rear > front, np.zeros(len(group), np.bool_)):
            yield FollowingTrack(
                site="i80",
                period=int(group["period"].iloc[0]),
                follower=int(group["follower"].iloc[0]),
                leader=int(group["leader"].iloc[0]),
                leader_length=float(group["leader_length_m"].iloc[0]),
                first_frame=int(frame[run.start]),
                front=front[run],
                speed=_numbers(group, "follower_speed_mps")[run],
                leader_rear=rear[run],
                leader_speed=_numbers(group, "leader_speed_mps")[run],
            )


def lanes(data: Path) -> Iterator[FollowingTrack]:
    """Yields the vehicles of the lanes 1 and 7 of I-80 behind cars; see :func:`following_tracks`."""
    needed = ("period", "lane", "vehicle_id", "frame", "local_y_m", "speed_mps", "class", "preceding", "preceding_y_m")
    table = read_table(data / LANES, needed)
    car = table.loc[table["class"] == CAR_CLASS, ["period", "vehicle_id"]].drop_duplicates()
    ahead = table.merge(car, left_on=["period", "preceding"], right_on=["period", "vehicle_id"], suffixes=("", "_car"))
    ahead = ahead.rename(columns={"preceding": "leader", "preceding_y_m": "leader_front"})
    for _, group in ahead.sort_values("frame").groupby(["period", "lane", "vehicle_id"]):
        yield from _behind("i80", group)


def vehicles(data: Path) -> Iterator[FollowingTrack]:
    """Yields the single vehicles of US-101; see :func:`following_tracks`."""
    needed = ("period", "vehicle_id", "frame", "local_y_m", "speed_mps", "space_headway_m")
    table = read_table(data / VEHICLES, needed)  # a headway of 0 is none
    ahead = table.assign(leader=-1, leader_front=table["local_y_m"] + table["space_headway_m"])
    for _, group in ahead.sort_values("frame").groupby(["period", "vehicle_id"]):
        yield from _behind("us101", group)


def _behind(site: str, group: pd.DataFrame) -> Iterator[FollowingTrack]:
    """Yields the tracks of a vehicle, cut where its leader changes, jumps, or is too near or far.

    `group` has its rows, and in columns `leader` and `leader_front` [m] those of its leader.
    """
    front, recorded, leader_front = (_numbers(group, name) for name in ("local_y_m", "speed_mps", "leader_front"))
    leader, frame = group["leader"].to_numpy(), group["frame"].to_numpy()
    there = (leader_front - CAR_LENGTH > front) & (leader_front - front < HEADWAY_MAX)
    moved = np.diff(leader_front, prepend=np.nan)
    changes = (np.diff(leader, prepend=leader[0]) != 0) | (np.abs(moved - recorded * STEP_S) > JUMP)
    for whole in _runs(frame, there, changes):
        run = slice(whole.start + 1, whole.stop)  # the speed of the leader needs the step before
        yield FollowingTrack(
            site=site,
            period=int(group["period"].iloc[0]),
            follower=int(group["vehicle_id"].iloc[0]),
            leader=int(leader[run.start]),
            leader_length=CAR_LENGTH,
            first_frame=int(frame[run.start]),
            front=front[run],
            speed=np.maximum(trailing_fit(recorded[whole])[1:], 0.0),
            leader_rear=leader_front[run] - CAR_LENGTH,
            leader_speed=np.maximum(trailing_fit(moved[run] / STEP_S), 0.0),
        )


def _runs(frame: IntArray, there: BoolArray, changes: BoolArray) -> Iterator[slice]:
    """Yields runs of more than :data:`SHORTEST` rows that are `there` in successive frames, without `changes`."""
    cuts = changes | (np.diff(there, prepend=there[:1])) | (np.diff(frame, prepend=frame[0] - 1) != 1)
    begins = np.flatnonzero(cuts).tolist()
    for begin, end in zip([0, *begins], [*begins, len(frame)], strict=True):
        if end - begin > SHORTEST and there[begin]:
            yield slice(begin, end)


def _numbers(group: pd.DataFrame, name: str) -> FloatArray:
    return group[name].to_numpy(np.float64)
