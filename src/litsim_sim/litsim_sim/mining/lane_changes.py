"""Lane changes of every agent, told from swerves that come back and from turns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.mining.lane_tracks import NOWHERE, LaneTracks, runs

CENTRE_M = 0.375  # [m] from a centre line within which an agent wanders in its lane (R157's wandering zone)
LATERAL_SPEED_MIN = 0.1  # [m/s] slower is drift
STAYED_S = 2.0  # [s] in a lane, off its centre, after which it is the agent's lane all the same


@dataclass(frozen=True)
class LaneChange:
    """An agent goes to a neighbour lane and stays there.

    Attributes:
        agent: row in the log.
        begin: first step at which it leaves its wandering zone, moving at least 0.1 m/s across.
        cross: first step at which its centre is in the new lane.
        end: first step at which it is within the wandering zone of the new lane, or hardly moves across any more.
        left: whether it goes to the left.
        from_lane, to_lane: lanes before and at `cross`, as positions in the lane map.
        lateral_speed: the greatest of the change [m/s].
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
    def duration_s(self) -> float:
        """From leaving the wandering zone to arriving in the new one [s]."""
        return (self.end - self.begin) * STEP_S


def lane_changes(tracks: LaneTracks) -> list[LaneChange]:
    """The lane changes of all agents, by agent and time.

    A lane counts as taken when the agent comes within 0.375 m of its centre line, or stays in it for 2 s, and the one
    that it is first seen in; what comes back before is no change. Neither is what crosses two borders at once, nor what
    turns at a junction.
    """
    found = []
    for row in range(len(tracks.lane)):
        for begin, end in runs(tracks.stretch[row]):
            if tracks.stretch[row, begin] != NOWHERE:
                found += _changes(tracks, row, begin, end)
    return found


def _changes(tracks: LaneTracks, row: int, first: int, last: int) -> list[LaneChange]:
    """Changes within one stretch, the steps from `first` up to `last` (exclusive) of the agent in `row`."""
    level, centred = tracks.level[row], np.abs(tracks.d[row]) <= CENTRE_M
    taken = [
        (first + begin, first + end)
        for begin, end in runs(level[first:last])
        if begin == 0 or end - begin >= round(STAYED_S / STEP_S) or centred[first + begin : first + end].any()
    ]
    found = []
    for before, after in pairwise(taken):
        step, cross = int(level[after[0]] - level[before[0]]), after[0]
        if abs(step) != 1:
            continue
        speed = step * tracks.lateral_speed[row]
        begin, end = _borders(centred, speed, (before[0], cross, after[1]))
        fastest = float(speed[begin : end + 1].max())
        if fastest >= LATERAL_SPEED_MIN:
            lanes = (int(tracks.lane[row, cross - 1]), int(tracks.lane[row, cross]))
            found.append(LaneChange(row, begin, cross, end, step > 0, *lanes, fastest))
    return found


def _borders(centred: BoolArray, speed: FloatArray, steps: tuple[int, int, int]) -> tuple[int, int]:
    """First and last step of a change that crosses at the second of `steps`, between the first and the third."""
    low, cross, high = steps
    still: BoolArray = centred | (speed < LATERAL_SPEED_MIN)
    before: IntArray = np.flatnonzero(still[low:cross])
    after: IntArray = np.flatnonzero(still[cross:high])
    begin = low + int(before[-1]) + 1 if len(before) else low
    return begin, cross + int(after[0]) if len(after) else high - 1
