"""Lane changes of every agent, as opposed to swerves and turns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from litsim_data.mining.lane_tracks import NOWHERE, LaneTracks, runs
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray

CENTRE_M = 0.375  # [m] half width of the wandering zone around a centre line (R157)
LATERAL_SPEED_MIN = 0.1  # [m/s] slower lateral motion is drift
STAYED_S = 2.0  # [s] time in a lane after which it counts as taken, even off its centre


@dataclass(frozen=True)
class LaneChange:
    """A change of an agent to an adjacent lane, in which it stays.

    Attributes:
        agent: row in the log.
        begin: first step off the wandering zone with a lateral speed of at least 0.1 m/s.
        cross: first step with its centre in the new lane.
        end: first step in the wandering zone of the new lane, or with less lateral speed.
        left: whether the change is to the left.
        from_lane, to_lane: lanes before and at `cross`, as indices in the lane map.
        lateral_speed: largest lateral speed of the change [m/s].
    """

    agent: int
    begin: int
    cross: int
    end: int
    left: bool
    from_lane: int
    to_lane: int
    lateral_speed: float

    @property
    def steps(self) -> tuple[int, int, int]:
        """Its steps `begin`, `cross` and `end`."""
        return self.begin, self.cross, self.end

    @property
    def duration_s(self) -> float:
        """Time from leaving the wandering zone to arriving in the new one [s]."""
        return (self.end - self.begin) * STEP_S


def lane_changes(tracks: LaneTracks) -> list[LaneChange]:
    """Returns the lane changes of all agents, sorted by agent and time.

    A lane counts as taken if the agent comes within 0.375 m of its centre line, stays in it for 2 s, or is first seen
    in it; excursions to other lanes are not changes, nor are crossings of two borders at once, nor turns at junctions.
    """
    changes = []
    for row in range(len(tracks.lane)):
        for begin, end in runs(tracks.stretch[row]):
            if tracks.stretch[row, begin] != NOWHERE:
                changes += _changes(tracks, row, begin, end)
    return changes


def _changes(tracks: LaneTracks, row: int, first: int, last: int) -> list[LaneChange]:
    """Returns changes of the agent in `row` within one stretch, the steps from `first` to `last` (exclusive)."""
    level, centred = tracks.level[row], np.abs(tracks.d[row]) <= CENTRE_M
    lanes_taken = [
        (first + begin, first + end)
        for begin, end in runs(level[first:last])
        if begin == 0 or end - begin >= round(STAYED_S / STEP_S) or centred[first + begin : first + end].any()
    ]
    changes = []
    for before, after in pairwise(lanes_taken):
        step, cross = int(level[after[0]] - level[before[0]]), after[0]
        if abs(step) != 1:
            continue
        speed = step * tracks.lateral_speed[row]
        begin, end = _borders(centred, speed, (before[0], cross, after[1]))
        fastest = float(speed[begin : end + 1].max())
        if fastest >= LATERAL_SPEED_MIN:
            lanes = (int(tracks.lane[row, cross - 1]), int(tracks.lane[row, cross]))
            changes.append(LaneChange(row, begin, cross, end, step > 0, *lanes, fastest))
    return changes


def _borders(centred: BoolArray, speed: FloatArray, steps: tuple[int, int, int]) -> tuple[int, int]:
    """Returns first and last step of a change that crosses at the second of `steps`, within the first and the third."""
    low, cross, high = steps
    still: BoolArray = centred | (speed < LATERAL_SPEED_MIN)
    before: IntArray = np.flatnonzero(still[low:cross])
    after: IntArray = np.flatnonzero(still[cross:high])
    begin = low + int(before[-1]) + 1 if len(before) else low
    return begin, cross + int(after[0]) if len(after) else high - 1
