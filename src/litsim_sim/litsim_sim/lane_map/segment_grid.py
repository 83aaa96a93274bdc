"""The straight segments of all lanes as arrays, and a grid that finds those near a point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.kernels.compiled import Bools, Floats, Floats2, Floats3, Ints, Ints2, kernel
from litsim_sim.lane_map.net_lanes import Lane

CELL = 16.0  # [m] of the lookup grid
REACH = 12.0  # [m] around a cell within which its candidates are complete; farther poses search the whole net


class SegmentArrays(NamedTuple):
    """The k segments between neighbouring vertices of centre lines, lane after lane, and these lanes.

    Attributes:
        start_x, start_y: (k,) where a segment begins, in frame map [m].
        start_s: (k,) arc length of the lane there [m].
        cos, sin, heading: (k,) direction of a segment, and the same as an angle [rad].
        size: (k,) length of a segment [m].
        first: first segment of each lane, and behind the last one the number of all.
        length: length of each lane [m].
    """

    start_x: Floats
    start_y: Floats
    start_s: Floats
    cos: Floats
    sin: Floats
    heading: Floats
    size: Floats
    first: Ints
    length: Floats


class GridArrays(NamedTuple):
    """A lookup grid.

    Attributes:
        cells: (cells + 1, c) segments that can be within REACH of points in each cell, padded with -1; in the last row,
            which is for points off the grid, there are none.
        x_min, y_min: corner of the bounds of all centre lines [m].
        columns, rows: of cells.
    """

    cells: Ints2
    x_min: float
    y_min: float
    columns: int
    rows: int


def segments_of(lanes: Sequence[Lane]) -> SegmentArrays:
    """Returns the segments of the centre lines of `lanes`."""
    starts = np.concatenate([lane.centerline[:-1] for lane in lanes]).astype(np.float64)
    step = np.concatenate([np.diff(lane.centerline, axis=0) for lane in lanes]).astype(np.float64)
    size = np.hypot(step[:, 0], step[:, 1])
    return SegmentArrays(
        start_x=starts[:, 0],
        start_y=starts[:, 1],
        start_s=np.concatenate([lane.s[:-1] for lane in lanes]).astype(np.float64),
        cos=step[:, 0] / size,
        sin=step[:, 1] / size,
        heading=np.arctan2(step[:, 1], step[:, 0]),
        size=size,
        first=np.cumsum([0, *(len(lane.s) - 1 for lane in lanes)]),
        length=np.array([lane.length for lane in lanes], np.float64),
    )


def grid_over(bounds: tuple[float, float, float, float], of: SegmentArrays) -> GridArrays:
    """Returns the grid over segments, and the `bounds` x min, y min, x max, y max of these [m]."""
    x_min, y_min, x_max, y_max = bounds
    columns = int((x_max - x_min + 2 * REACH) // CELL) + 1
    rows = int((y_max - y_min + 2 * REACH) // CELL) + 1
    lists: list[list[int]] = [[] for _ in range(columns * rows + 1)]
    margin = REACH + CELL
    for segment in range(len(of.size)):
        # A cell's segments are complete for its own points: centre of the cell, half its diagonal, and REACH.
        ends_x = of.start_x[segment] + np.array([0.0, of.size[segment] * of.cos[segment]])
        ends_y = of.start_y[segment] + np.array([0.0, of.size[segment] * of.sin[segment]])
        from_column = max(int((ends_x.min() - margin - x_min + REACH) // CELL), 0)
        to_column = min(int((ends_x.max() + margin - x_min + REACH) // CELL), columns - 1)
        from_row = max(int((ends_y.min() - margin - y_min + REACH) // CELL), 0)
        to_row = min(int((ends_y.max() + margin - y_min + REACH) // CELL), rows - 1)
        column, row = np.meshgrid(np.arange(from_column, to_column + 1), np.arange(from_row, to_row + 1))
        centre_x = x_min - REACH + (column.astype(np.float64) + 0.5) * CELL
        centre_y = y_min - REACH + (row.astype(np.float64) + 0.5) * CELL
        near = distance(centre_x, centre_y, of, np.array(segment)) <= REACH + CELL * np.sqrt(0.5)
        for cell in (row * columns + column)[near]:
            lists[cell].append(segment)
    cells = np.full((len(lists), max(map(len, lists))), -1, np.int64)
    for cell, members in enumerate(lists):
        cells[cell, : len(members)] = members
    return GridArrays(cells, x_min, y_min, columns, rows)


def distance(x: FloatArray, y: FloatArray, of: SegmentArrays, segment: IntArray) -> FloatArray:
    """Returns the distance of points to segments [m]; shapes broadcast."""
    dx, dy = x - of.start_x[segment], y - of.start_y[segment]
    along = dx * of.cos[segment] + dy * of.sin[segment]
    over = np.maximum(np.maximum(-along, along - of.size[segment]), 0.0)
    return cast(FloatArray, np.hypot(over, dy * of.cos[segment] - dx * of.sin[segment]))


@kernel
def _distance(x: float, y: float, segments: SegmentArrays, segment: int) -> float:
    """Returns the distance [m] of a point to a segment."""
    dx, dy = x - segments.start_x[segment], y - segments.start_y[segment]
    cos, sin = segments.cos[segment], segments.sin[segment]
    along, left = dx * cos + dy * sin, dy * cos - dx * sin
    return math.hypot(max(-along, along - segments.size[segment], 0.0), left)


@kernel
def _cell(x: float, y: float, grid: GridArrays) -> int:
    """Returns the cell of a point; the one after the last for all points off the grid."""
    column, row = np.floor((x - grid.x_min + REACH) / CELL), np.floor((y - grid.y_min + REACH) / CELL)
    inside = 0 <= column < grid.columns and 0 <= row < grid.rows
    return int(row * grid.columns + column) if inside else grid.columns * grid.rows


@kernel
def _cost(
    x: float, y: float, cos: float, sin: float, turn: float, segments: SegmentArrays, handicap: Floats, segment: int
) -> float:
    """Returns what :func:`nearest_segments` minimises, for one pose and one segment [m]."""
    facing = cos * segments.cos[segment] + sin * segments.sin[segment]
    return _distance(x, y, segments, segment) + handicap[segment] + turn * (1.0 - facing)


@kernel
def nearest_segments(
    x: Floats,
    y: Floats,
    cos: Floats,
    sin: Floats,
    turn: float,
    grid: GridArrays,
    handicap: Floats,
    segments: SegmentArrays,
) -> tuple[Ints, Floats2]:
    """Returns the segments of least cost: distance, handicap, and `turn` times 1 - cos of the angle to the heading.

    Of segments that cost the same, the first is taken. Off the grid all segments are looked at. Poses are (n,),
    handicaps (k,) [m] of the segments. The results are segments (n,), and (2, n) arc lengths of their lanes at the
    poses, no farther than the segments go, and how far poses are to the left [m].
    """
    nearest, place = np.zeros(len(x), np.int64), np.empty((2, len(x)))
    for i in range(len(x)):
        least = np.inf
        for segment in grid.cells[_cell(x[i], y[i], grid)]:
            if segment < 0:
                break
            cost = _cost(x[i], y[i], cos[i], sin[i], turn, segments, handicap, segment)
            if cost < least:
                nearest[i], least = segment, cost
        if not least <= REACH:
            least = np.inf
            for segment in range(len(segments.size)):
                cost = _cost(x[i], y[i], cos[i], sin[i], turn, segments, handicap, segment)
                if cost < least:
                    nearest[i], least = segment, cost
        index = nearest[i]
        dx, dy = x[i] - segments.start_x[index], y[i] - segments.start_y[index]
        along = dx * segments.cos[index] + dy * segments.sin[index]
        place[0, i] = segments.start_s[index] + within(along, 0.0, segments.size[index])
        place[1, i] = dy * segments.cos[index] - dx * segments.sin[index]
    return nearest, place


@kernel
def any_within(x: Floats, y: Floats, grid: GridArrays, segments: SegmentArrays, reach: Floats) -> Bools:
    """Returns whether points `x`, `y` (n,) [m] are within `reach` (k,), at most REACH, of some segment (n,)."""
    near = np.zeros(len(x), np.bool_)
    for i in range(len(x)):
        for segment in grid.cells[_cell(x[i], y[i], grid)]:
            if segment < 0:
                break
            if _distance(x[i], y[i], segments, segment) <= reach[segment]:
                near[i] = True
                break
    return near


@kernel
def _segment_at(lane: int, s: float, segments: SegmentArrays) -> int:
    """Returns the segment of a lane at an arc length `s` [m]; beyond its ends a lane is continued straight."""
    begin, end = segments.first[lane], segments.first[lane + 1]
    on_lane = within(s, 0.0, segments.length[lane])
    segment = begin + np.searchsorted(segments.start_s[begin:end], on_lane, side="right") - 1
    return int(min(max(segment, begin), end - 1))


@kernel
def segments_at(lane: Ints, s: Floats, segments: SegmentArrays) -> Ints:
    """Returns the segments (n,) of lanes at arc lengths `lane` and `s` (n,); see :func:`_segment_at`."""
    segment = np.empty(len(s), np.int64)
    for i in range(len(s)):
        segment[i] = _segment_at(lane[i], s[i], segments)
    return segment


@kernel
def poses_along(lane: Ints, s: Floats, following: Ints, steps: int, step: float, segments: SegmentArrays) -> Floats3:
    """See :meth:`.LaneMap.poses_along`; `following` is the lane that follows each lane, -1 where none does."""
    poses = np.empty((len(lane), steps, 3))
    for i in range(len(lane)):
        here, place = lane[i], s[i]
        for k in range(steps):
            while place > segments.length[here] and following[here] >= 0:
                place -= segments.length[here]
                here = following[here]
            segment = _segment_at(here, place, segments)
            along = place - segments.start_s[segment]
            poses[i, k, 0] = segments.start_x[segment] + along * segments.cos[segment]
            poses[i, k, 1] = segments.start_y[segment] + along * segments.sin[segment]
            poses[i, k, 2] = segments.heading[segment]
            place += step
    return poses
