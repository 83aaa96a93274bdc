"""The straight segments of all lanes as arrays, and a grid that finds those near a point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np
from numba.types import Tuple

from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    FLOATS,
    FLOATS2,
    INTS,
    OUT_BOOLS,
    OUT_FLOATS2,
    OUT_FLOATS3,
    OUT_INTS,
    Floats,
    Floats2,
    Ints,
    Ints2,
    float64,
    int64,
    kernel,
    tuple_type,
)
from litsim_sim.lane_map.net_lanes import Lane

CELL = 16.0  # [m] of the lookup grid
REACH = 12.0  # [m] around a cell within which its candidates are complete; farther poses search the whole net


class SegmentArrays(NamedTuple):
    """The segments (k,) and lanes of a :class:`SegmentGrid`.

    Attributes:
        start_x, start_y, start_s, cos, sin, heading: (k,) as there.
        first: first segment of each lane, and behind the last one the number of all.
        length: length of each lane [m].
    """

    start_x: Floats
    start_y: Floats
    start_s: Floats
    cos: Floats
    sin: Floats
    heading: Floats
    first: Ints
    length: Floats


class GridArrays(NamedTuple):
    """The grid of a :class:`SegmentGrid`.

    Attributes:
        lines: (k, 5) start x and y, direction x and y, and length of each segment.
        cells: (cells + 1, c) candidates of each cell, padded with -1.
        x_min, y_min: corner of the bounds of all centre lines [m].
        columns, rows: of cells.
    """

    lines: Floats2
    cells: Ints2
    x_min: float
    y_min: float
    columns: int
    rows: int


SEGMENTS, GRID = tuple_type(SegmentArrays), tuple_type(GridArrays)


class SegmentGrid:
    """The k segments between neighbouring vertices of centre lines, lane after lane.

    Attributes:
        lane: (k,) position of each segment's lane among the lanes given.
        start_x, start_y: (k,) where a segment begins, in frame map [m].
        start_s: (k,) arc length of the lane there [m].
        size: (k,) length of a segment [m].
        cos, sin, heading: (k,) direction of a segment, and the same as an angle [rad].
    """

    def __init__(self, lanes: Sequence[Lane], bounds: tuple[float, float, float, float]) -> None:
        """`bounds` of all centre lines: x min, y min, x max, y max [m]."""
        counts = [len(lane.s) - 1 for lane in lanes]
        self.lane = np.repeat(np.arange(len(lanes)), counts)
        starts = np.concatenate([lane.centerline[:-1] for lane in lanes]).astype(np.float64)
        step = np.concatenate([np.diff(lane.centerline, axis=0) for lane in lanes]).astype(np.float64)
        self.size: FloatArray = np.hypot(step[:, 0], step[:, 1])
        self.start_x, self.start_y = starts[:, 0], starts[:, 1]
        self.cos, self.sin = step[:, 0] / self.size, step[:, 1] / self.size
        self.heading: FloatArray = np.arctan2(step[:, 1], step[:, 0])
        self.start_s = np.concatenate([lane.s[:-1] for lane in lanes]).astype(np.float64)
        self._first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)  # segment of each lane
        self._length = np.array([lane.length for lane in lanes], np.float64)
        self._bounds = bounds
        self._cells, self._shape = self._make_grid()
        self._lines = np.column_stack([self.start_x, self.start_y, self.cos, self.sin, self.size])

    def __len__(self) -> int:
        return len(self.size)

    def project(self, x: FloatArray, y: FloatArray, segment: IntArray) -> tuple[FloatArray, FloatArray]:
        """Returns how far points lie along their segments, and how far to the left [m]; shapes broadcast."""
        dx, dy = x - self.start_x[segment], y - self.start_y[segment]
        cos, sin = self.cos[segment], self.sin[segment]
        return dx * cos + dy * sin, dy * cos - dx * sin

    def distance(self, x: FloatArray, y: FloatArray, segment: IntArray) -> FloatArray:
        """Returns the distance of points to segments [m]; shapes broadcast."""
        along, d = self.project(x, y, segment)
        over = np.maximum(np.maximum(-along, along - self.size[segment]), 0.0)
        return cast(FloatArray, np.hypot(over, d))

    def pose_at(self, lane: IntArray, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y [m] and heading [rad] at arc lengths `s` [m] of the lanes at positions `lane`; shapes broadcast.

        Beyond its ends a lane is continued straight.
        """
        if lane.shape != s.shape:
            lane, s = np.broadcast_arrays(lane, s)
        lanes, lengths = np.ascontiguousarray(lane).reshape(-1), np.ascontiguousarray(s).reshape(-1)
        segment = _segments_at(lanes, lengths, self._arrays).reshape(s.shape)
        along = s - self.start_s[segment]
        x = self.start_x[segment] + along * self.cos[segment]
        y = self.start_y[segment] + along * self.sin[segment]
        return x, y, self.heading[segment]

    def headings_around(self, lane: IntArray, s: FloatArray, reach: float) -> FloatArray:
        """See :meth:`LaneMap.headings_around`."""
        return _headings_around(lane, s, reach, self._arrays)

    def poses_along(self, lane: IntArray, s: FloatArray, following: IntArray, steps: int, step: float) -> FloatArray:
        """See :meth:`LaneMap.poses_along`.

        Args:
            lane, s: (n,) positions of the lanes on which the poses begin, and arc lengths there [m].
            following: position of the lane that follows each lane, -1 where none does.
            steps, step: number of poses, and distance between them [m].
        """
        return _poses_along(np.ascontiguousarray(lane), np.ascontiguousarray(s), following, steps, step, self._arrays)

    @cached_property
    def _arrays(self) -> SegmentArrays:
        """The segments as kernels take them."""
        return SegmentArrays(
            self.start_x, self.start_y, self.start_s, self.cos, self.sin, self.heading, self._first, self._length
        )

    def nearest(
        self, x: FloatArray, y: FloatArray, yaw: FloatArray, handicap: FloatArray, turn: float
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Returns the segments of least cost: distance, handicap, and `turn` times 1 - cos of the angle to the heading.

        Of segments that cost the same, the first is taken.

        Args:
            x, y, yaw: (n,) poses [m], [rad].
            handicap: (k,) of the segments [m].
            turn: [m].

        Returns:
            segments (n,), arc lengths (n,) of their lanes at the poses, no farther than the segments go, and how far
            (n,) poses are to the left [m].
        """
        segment, (s, d) = _nearest(x, y, np.cos(yaw), np.sin(yaw), turn, self._grid, handicap, self.start_s)
        return segment, s, d

    def any_within(self, x: FloatArray, y: FloatArray, reach: FloatArray) -> BoolArray:
        """Returns whether points `x`, `y` (n,) [m] are within `reach` (k,), at most REACH, of some segment (n,)."""
        return _any_within(x, y, self._grid, reach)

    @cached_property
    def _grid(self) -> GridArrays:
        """The grid as kernels take it."""
        return GridArrays(self._lines, self._cells, self._bounds[0], self._bounds[1], *self._shape)

    def candidates(self, x: FloatArray, y: FloatArray) -> IntArray:
        """Returns the segments (n, k) that can be within REACH of each point, padded with -1; all -1 off the grid."""
        columns, rows = self._shape
        column = np.floor((x - self._bounds[0] + REACH) / CELL)
        row = np.floor((y - self._bounds[1] + REACH) / CELL)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cell = np.where(inside, row * columns + column, columns * rows).astype(np.int64)
        return self._cells[cell]

    def _make_grid(self) -> tuple[IntArray, tuple[int, int]]:
        """Returns candidates (cells + 1, k) by cell; the last row serves all points outside of the grid."""
        x_min, y_min, x_max, y_max = self._bounds
        columns = int((x_max - x_min + 2 * REACH) // CELL) + 1
        rows = int((y_max - y_min + 2 * REACH) // CELL) + 1
        lists: list[list[int]] = [[] for _ in range(columns * rows + 1)]
        for segment in range(len(self.size)):
            # A cell's candidates are complete for its own points: centre of the cell, half its diagonal, and REACH.
            margin = REACH + CELL
            ends_x = self.start_x[segment] + np.array([0.0, self.size[segment] * self.cos[segment]])
            ends_y = self.start_y[segment] + np.array([0.0, self.size[segment] * self.sin[segment]])
            from_column = max(int((ends_x.min() - margin - x_min + REACH) // CELL), 0)
            to_column = min(int((ends_x.max() + margin - x_min + REACH) // CELL), columns - 1)
            from_row = max(int((ends_y.min() - margin - y_min + REACH) // CELL), 0)
            to_row = min(int((ends_y.max() + margin - y_min + REACH) // CELL), rows - 1)
            column, row = np.meshgrid(np.arange(from_column, to_column + 1), np.arange(from_row, to_row + 1))
            centre_x = x_min - REACH + (column.astype(np.float64) + 0.5) * CELL
            centre_y = y_min - REACH + (row.astype(np.float64) + 0.5) * CELL
            near = self.distance(centre_x, centre_y, np.array(segment)) <= REACH + CELL * np.sqrt(0.5)
            for cell in (row * columns + column)[near]:
                lists[cell].append(segment)
        grid = np.full((len(lists), max(len(entry) for entry in lists)), -1, np.int64)
        for cell, entry in enumerate(lists):
            grid[cell, : len(entry)] = entry
        return grid, (columns, rows)


@kernel(float64(float64, float64, FLOATS2, int64))
def _distance(x: float, y: float, lines: FloatArray, segment: int) -> float:
    """Returns the distance [m] of a point to a segment of `lines` (k, 5): start x and y, direction x and y, length."""
    dx, dy, cos, sin = x - lines[segment, 0], y - lines[segment, 1], lines[segment, 2], lines[segment, 3]
    along, left = dx * cos + dy * sin, dy * cos - dx * sin
    return math.hypot(max(-along, along - lines[segment, 4], 0.0), left)


@kernel(int64(float64, float64, GRID))
def _cell(x: float, y: float, grid: GridArrays) -> int:
    """Returns the cell of a point; the one after the last for all points off the grid."""
    column, row = np.floor((x - grid.x_min + REACH) / CELL), np.floor((y - grid.y_min + REACH) / CELL)
    inside = 0 <= column < grid.columns and 0 <= row < grid.rows
    return int(row * grid.columns + column) if inside else grid.columns * grid.rows


@kernel(float64(*[float64] * 5, FLOATS2, FLOATS, int64))
def _cost(
    x: float, y: float, cos: float, sin: float, turn: float, lines: FloatArray, handicap: FloatArray, segment: int
) -> float:
    """Returns what :meth:`SegmentGrid.nearest` minimises, for one pose and one segment [m]."""
    facing = cos * lines[segment, 2] + sin * lines[segment, 3]
    return _distance(x, y, lines, segment) + handicap[segment] + turn * (1.0 - facing)


@kernel(Tuple((OUT_INTS, OUT_FLOATS2))(*[FLOATS] * 4, float64, GRID, FLOATS, FLOATS))
def _nearest(
    x: FloatArray,
    y: FloatArray,
    cos: FloatArray,
    sin: FloatArray,
    turn: float,
    grid: GridArrays,
    handicap: FloatArray,
    start_s: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """See :meth:`SegmentGrid.nearest`; `cos`, `sin` (n,) of the headings. Off the grid all segments are looked at.

    Returns:
        segments (n,), and arc lengths and offsets (2, n).
    """
    nearest, place = np.zeros(len(x), np.int64), np.empty((2, len(x)))
    for i in range(len(x)):
        least = np.inf
        for segment in grid.cells[_cell(x[i], y[i], grid)]:
            if segment < 0:
                break
            cost = _cost(x[i], y[i], cos[i], sin[i], turn, grid.lines, handicap, segment)
            if cost < least:
                nearest[i], least = segment, cost
        if not least <= REACH:
            least = np.inf
            for segment in range(len(grid.lines)):
                cost = _cost(x[i], y[i], cos[i], sin[i], turn, grid.lines, handicap, segment)
                if cost < least:
                    nearest[i], least = segment, cost
        line = grid.lines[nearest[i]]
        dx, dy = x[i] - line[0], y[i] - line[1]
        place[0, i] = start_s[nearest[i]] + within(dx * line[2] + dy * line[3], 0.0, line[4])
        place[1, i] = dy * line[2] - dx * line[3]
    return nearest, place


@kernel(OUT_BOOLS(FLOATS, FLOATS, GRID, FLOATS))
def _any_within(x: FloatArray, y: FloatArray, grid: GridArrays, reach: FloatArray) -> BoolArray:
    """See :meth:`SegmentGrid.any_within`."""
    near = np.zeros(len(x), np.bool_)
    for i in range(len(x)):
        for segment in grid.cells[_cell(x[i], y[i], grid)]:
            if segment < 0:
                break
            if _distance(x[i], y[i], grid.lines, segment) <= reach[segment]:
                near[i] = True
                break
    return near


@kernel(int64(int64, float64, SEGMENTS))
def _segment_at(lane: int, s: float, segments: SegmentArrays) -> int:
    """Returns the segment of a lane at an arc length `s` [m]; beyond its ends a lane is continued straight."""
    begin, end = segments.first[lane], segments.first[lane + 1]
    at = begin + np.searchsorted(segments.start_s[begin:end], within(s, 0.0, segments.length[lane]), side="right") - 1
    return int(min(max(at, begin), end - 1))


@kernel(OUT_INTS(INTS, FLOATS, SEGMENTS))
def _segments_at(lane: IntArray, s: FloatArray, segments: SegmentArrays) -> IntArray:
    """Returns the segments (n,) of lanes at arc lengths `lane` and `s` (n,); see :func:`_segment_at`."""
    segment = np.empty(len(s), np.int64)
    for i in range(len(s)):
        segment[i] = _segment_at(lane[i], s[i], segments)
    return segment


@kernel(OUT_FLOATS2(INTS, FLOATS, float64, SEGMENTS))
def _headings_around(lane: IntArray, s: FloatArray, reach: float, segments: SegmentArrays) -> FloatArray:
    """See :meth:`SegmentGrid.headings_around`."""
    heading = np.empty((len(s), 2))
    for i in range(len(s)):
        heading[i, 0] = segments.heading[_segment_at(lane[i], s[i] - reach, segments)]
        heading[i, 1] = segments.heading[_segment_at(lane[i], s[i] + reach, segments)]
    return heading


@kernel(OUT_FLOATS3(INTS, FLOATS, INTS, int64, float64, SEGMENTS))
def _poses_along(
    lane: IntArray, s: FloatArray, following: IntArray, steps: int, step: float, segments: SegmentArrays
) -> FloatArray:
    """See :meth:`SegmentGrid.poses_along`."""
    poses = np.empty((len(lane), steps, 3))
    for i in range(len(lane)):
        here, at = lane[i], s[i]
        for k in range(steps):
            while at > segments.length[here] and following[here] >= 0:
                at -= segments.length[here]
                here = following[here]
            segment = _segment_at(here, at, segments)
            along = at - segments.start_s[segment]
            poses[i, k, 0] = segments.start_x[segment] + along * segments.cos[segment]
            poses[i, k, 1] = segments.start_y[segment] + along * segments.sin[segment]
            poses[i, k, 2] = segments.heading[segment]
            at += step
    return poses
