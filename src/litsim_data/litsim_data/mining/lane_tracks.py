"""A log on the lanes of its net: lane and position of each agent, and its motion across lanes.

Arrays have shape (n, steps), agents as in the log.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.lane_graph import straightest_successors
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.scenario.log import Log

NOWHERE = -1  # index of no lane
OFF_LANE_M = 1.0  # [m] distance beyond the border of the nearest lane at which an agent is on no lane
TURN_RAD = np.deg2rad(45.0)  # smallest change of heading of a turn
LATERAL_SPAN = 5  # steps before and after over which a lateral speed is measured
CHUNK = 4096  # poses looked up at once, to bound memory: at junctions each is near hundreds of segments
JUMP_M = 0.6  # [m] largest lateral motion in a step; more is a mismatch of successive lanes


@dataclass(frozen=True)
class LaneTracks:
    """Positions of agents on the lanes.

    Attributes:
        lane: (n, steps) index in `LaneMap.lanes`; -1 for an agent that is not on the road, or on no lane.
        s: (n, steps) position along the lane [m].
        d: (n, steps) offset to the left of its centre line [m].
        along: (n, steps) speed along the lane [m/s].
        stretch: (n, steps) number of the stretch of a track over which lanes can be counted; a new one begins when an
            agent comes onto a lane from off the lanes, or from one that does not lead there. -1 where `lane` is.
        level: (n, steps) number of lanes to the left of that at the beginning of the stretch.
        lateral_speed: (n, steps) lateral speed to the left, across lanes, averaged over a second [m/s].
        following: (n, lanes) the lane that each agent takes after each lane: as recorded, else the straightest; -1 at
            the end of the net.
    """

    lane: IntArray
    s: FloatArray
    d: FloatArray
    along: FloatArray
    stretch: IntArray
    level: IntArray
    lateral_speed: FloatArray
    following: IntArray

    @classmethod
    def of(cls, log: Log, lane_map: LaneMap) -> LaneTracks:
        """Places the agents of `log` on the lanes of `lane_map`."""
        valid = log.valid & ~log.obstacle[:, None]  # pedestrians and cyclists do not keep to lanes
        width = lane_map.widths
        lane = np.full(valid.shape, NOWHERE)
        s, d, along = (np.zeros(valid.shape) for _ in range(3))
        there = np.nonzero(valid)
        for begin in range(0, len(there[0]), CHUNK):
            some = (there[0][begin : begin + CHUNK], there[1][begin : begin + CHUNK])
            nearest = lane_map.nearest(log.x[some], log.y[some], log.yaw[some])
            lane[some] = np.where(np.abs(nearest.d) <= 0.5 * width[nearest.lane] + OFF_LANE_M, nearest.lane, NOWHERE)
            s[some], d[some] = nearest.s, nearest.d
            along[some] = log.speed[some] * np.cos(log.yaw[some] - nearest.heading)
        ways = ways_of(lane_map)
        stretch, level = np.full(valid.shape, NOWHERE), np.zeros(valid.shape, np.int64)
        following = np.tile(np.array(ways.straightest, np.int64), (len(log.ids), 1))
        for row in range(len(log.ids)):
            stretch[row], level[row] = ways.levels(lane[row])
            for before, after in ways.taken(lane[row]):
                following[row, before] = after
        speed = _lateral_speed(lane, d, stretch, level, width)
        return cls(lane, s, d, along, stretch, level, speed, following)


class Ways:
    """Connections between the lanes of a net, by indices in a lane map.

    Attributes:
        straightest: the successor of each lane that turns least; -1 for none.
    """

    def __init__(self, lanes: tuple[Lane, ...]) -> None:
        self._lanes = lanes
        row = {lane.id: number for number, lane in enumerate(lanes)}
        self.successors = [tuple(row[name] for name in lane.successors) for lane in lanes]
        self.predecessors: list[list[int]] = [[] for _ in lanes]
        for number, following in enumerate(self.successors):
            for lane_after in following:
                self.predecessors[lane_after].append(number)
        self._edge: dict[str, list[int]] = {}
        for number, lane in enumerate(lanes):
            self._edge.setdefault(lane.edge_id, []).append(number)
        self._reached = [frozenset(self._through_junction(number)) for number in range(len(lanes))]
        self.straightest = [
            NOWHERE if lane_after is None else lane_after for lane_after in straightest_successors(lanes)
        ]

    def levels(self, lane: IntArray) -> tuple[IntArray, IntArray]:
        """Returns `LaneTracks.stretch` and `level` (steps,) of an agent on `lane` (steps,)."""
        stretch, level = np.full(len(lane), NOWHERE), np.zeros(len(lane), np.int64)
        number, height, last = -1, 0, NOWHERE
        for begin, end in runs(lane):
            here = int(lane[begin])
            if here == NOWHERE:
                last = NOWHERE
                continue
            internal = self._lanes[here].is_internal
            if last == NOWHERE:  # the log begins, also within a junction
                number, height = number + 1, 0
            elif not internal and here != last:
                step = self._step(last, here)
                number, height = (number + 1, 0) if step is None else (number, height + step)
            stretch[begin:end], level[begin:end] = number, height
            last = last if internal and last != NOWHERE else here
        return stretch, level

    def taken(self, lane: IntArray) -> Iterator[tuple[int, int]]:
        """Yields pairs of successive lanes of an agent on `lane` (steps,)."""
        passed = [int(lane[begin]) for begin, _ in runs(lane)]
        for before, after in pairwise(passed):
            if NOWHERE in (before, after):
                continue
            if after in self.successors[before]:
                yield before, after
            for between in self.successors[before]:  # a lane passed between two steps
                if after in self.successors[between]:
                    yield from ((before, between), (between, after))

    def _step(self, before: int, after: int) -> int | None:
        """Returns the number of lanes to the left by which an agent has changed; None if both are not comparable."""
        lanes = self._lanes
        if lanes[before].edge_id == lanes[after].edge_id:
            return lanes[after].index - lanes[before].index
        beside = self._edge[lanes[before].edge_id]
        steps = [
            lanes[lane_after].index - lanes[before].index for lane_after in beside if after in self._reached[lane_after]
        ]
        step = min(steps, key=abs, default=None)
        end, begin = (np.diff(lanes[lane].centerline, axis=0) for lane in (before, after))
        turn = np.arctan2(begin[0, 1], begin[0, 0]) - np.arctan2(end[-1, 1], end[-1, 0])
        return None if step and abs(float(wrap_angle(np.asarray(turn)))) > TURN_RAD else step

    def _through_junction(self, lane: int) -> Iterator[int]:
        """Yields the lanes outside junctions that follow a lane, directly or through lanes inside a junction."""
        waiting, visited = list(self.successors[lane]), set[int]()
        while waiting:
            lane_after = waiting.pop()
            if lane_after in visited:
                continue
            visited.add(lane_after)
            if self._lanes[lane_after].is_internal:
                waiting += self.successors[lane_after]
            else:
                yield lane_after


@lru_cache(maxsize=2)
def ways_of(lane_map: LaneMap) -> Ways:
    """Returns the connections between the lanes of `lane_map`, which are found once for the runs on a net."""
    return Ways(lane_map.lanes)


def runs(values: IntArray | BoolArray) -> list[tuple[int, int]]:
    """Returns the start and end (exclusive) of each run of equal `values` (k,)."""
    if not len(values):
        return []
    cuts = np.flatnonzero(values[1:] != values[:-1]) + 1
    return list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(values)], strict=True))


def true_runs(values: BoolArray) -> list[tuple[int, int]]:
    """Returns the start and end (exclusive) of each run of true `values` (k,)."""
    return [(begin, end) for begin, end in runs(values) if values[begin]]


def _lateral_speed(lane: IntArray, d: FloatArray, stretch: IntArray, level: IntArray, width: FloatArray) -> FloatArray:
    """Returns `LaneTracks.lateral_speed`, from offsets `d` made continuous across the borders of lanes."""
    step = np.zeros(d.shape)
    together = (stretch[:, 1:] == stretch[:, :-1]) & (stretch[:, 1:] != NOWHERE)
    half = 0.5 * (width[lane[:, 1:]] + width[lane[:, :-1]])
    moved = np.diff(d, axis=1) + np.diff(level, axis=1) * half
    step[:, 1:] = np.where(together & (np.abs(moved) <= JUMP_M), moved, 0.0)
    way = np.cumsum(step, axis=1)
    steps = np.arange(d.shape[1])
    # The first and last step within reach in the same stretch.
    early, late = np.maximum(steps - LATERAL_SPAN, 0), np.minimum(steps + LATERAL_SPAN, len(steps) - 1)
    first, last = np.zeros(d.shape, np.int64), np.zeros(d.shape, np.int64)
    for row in range(len(d)):
        for begin, end in runs(stretch[row]):
            first[row, begin:end], last[row, begin:end] = begin, end - 1
    early, late = np.maximum(early, first), np.minimum(late, last)
    span = (late - early) * STEP_S
    rows = np.arange(len(d))[:, None]
    return np.divide(way[rows, late] - way[rows, early], span, out=np.zeros(d.shape), where=span > 0.0)
