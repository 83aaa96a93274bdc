"""Polylines as padded arrays, with compiled queries: nearest points, and points at arc lengths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, Floats2, Floats3, Ints, kernel

PATH_BEHIND, PATH_AHEAD = 5.0, 150.0  # [m] of an agent's path, behind and ahead of it, that a policy is given
CHUNK = 8  # segments in a circle
SLACK = 1e-6  # [m] by which circles are widened, for rounding
X, Y, S, UNIT_X, UNIT_Y = range(5)  # columns of `PathBatch.segments`


@dataclass
class Projection:
    """Projections of k positions onto paths; arrays (k,).

    Attributes:
        segment: index of the path's segment with the nearest point.
        s: arc length of the nearest point [m], negative before the path and above its length beyond.
        d: offset of the position from the line of the segment, positive to the left [m].
    """

    segment: IntArray
    s: FloatArray
    d: FloatArray


class PathBatch(NamedTuple):
    """m polylines of up to L points; results for one do not depend on the others.

    First and last segments count as prolonged without end.

    Attributes:
        segments: (m, L, 5). Row [p, k] is vertex k of path p and the segment that begins there: x, y [m], arc length
            from the first vertex [m], and the unit vector of the segment. Rows beyond the last vertex are meaningless,
            as is the unit vector of the last.
        circles: (m, C, 3) that enclose chunks of CHUNK segments each: centre x, y, which is a vertex, and radius [m].
            They bound the distance of the segments to a position.
        counts: (m,) number of vertices of each, at least 2.
    """

    segments: Floats3
    circles: Floats3
    counts: Ints

    @classmethod
    def of(cls, polylines: Sequence[FloatArray]) -> PathBatch:
        """Lay out `polylines`, arrays (k, 2) of at least two points in frame map [m], no two neighbours equal."""
        counts = np.array([len(points) for points in polylines], np.int64)
        return cls(*_laid_out(np.concatenate(polylines) if len(polylines) else np.empty((0, 2)), counts), counts)

    def take(self, rows: IntArray) -> PathBatch:
        """Returns the paths at positions `rows`."""
        return PathBatch(self.segments[rows], self.circles[rows], self.counts[rows])

    @property
    def each(self) -> IntArray:
        """Indices (m,) of all paths."""
        return np.arange(len(self.counts))

    def project(self, path: IntArray, x: FloatArray, y: FloatArray) -> Projection:
        """Project positions `x`, `y` (k,) in frame map [m] onto the paths `path` (k,), given by their indices.

        Of equally near points, the first along the path is taken.
        """
        return Projection(*_project(self, path, x, y))

    def segment(self, s: FloatArray, path: IntArray) -> IntArray:
        """Returns segments (k,) of the paths with indices `path` (k,) at arc lengths `s` (k,) [m]."""
        return _segments_at(self, path, s)

    def window(self, s: FloatArray) -> tuple[IntArray, IntArray]:
        """Returns the range of the path points that policies are given, for agents at arc lengths `s` (m,) [m].

        Returns:
            first (m,) and end (m,), exclusive: from PATH_BEHIND behind the agents to the end of the segment at
            PATH_AHEAD.
        """
        return windows(self, s, PATH_BEHIND, PATH_AHEAD)

    def heading(self, path: int | IntArray, segment: IntArray) -> FloatArray:
        """Returns direction (...) [rad] of segments of the paths with indices `path`; shapes broadcast."""
        return np.arctan2(self.segments[path, segment, UNIT_Y], self.segments[path, segment, UNIT_X])

    def point(self, s: FloatArray, path: IntArray | None = None) -> FloatArray:
        """Points (k, 2) of the paths with indices `path` (k,), or of all in order, at arc lengths `s` (k,) [m]."""
        return _points_at(self, self.each if path is None else path, s)


@kernel
def _laid_out(points: Floats2, counts: Ints) -> tuple[Floats3, Floats3]:
    """Return `segments` and `circles` of a :class:`PathBatch` of `points` (N, 2) [m], `counts` (m,) in each path."""
    longest = 2
    for n in counts:
        longest = max(longest, n)
    segments = np.empty((len(counts), longest, 5))
    circles = np.empty((len(counts), (longest + CHUNK - 2) // CHUNK, 3))
    first = 0
    for p in range(len(counts)):
        n = counts[p]
        for k in range(n):
            segments[p, k, X], segments[p, k, Y] = points[first + k, 0], points[first + k, 1]
        segments[p, 0, S] = 0.0
        for k in range(1, n):
            step_x = segments[p, k, X] - segments[p, k - 1, X]
            step_y = segments[p, k, Y] - segments[p, k - 1, Y]
            segments[p, k, S] = segments[p, k - 1, S] + math.hypot(step_x, step_y)
            length = segments[p, k, S] - segments[p, k - 1, S]
            segments[p, k - 1, UNIT_X], segments[p, k - 1, UNIT_Y] = step_x / length, step_y / length
        for c in range((n + CHUNK - 2) // CHUNK):
            begin, end = c * CHUNK, min((c + 1) * CHUNK, n - 1)
            middle = (begin + end) // 2
            square = 0.0
            for k in range(begin, end + 1):
                away_x = segments[p, k, X] - segments[p, middle, X]
                away_y = segments[p, k, Y] - segments[p, middle, Y]
                square = max(square, away_x * away_x + away_y * away_y)
            circles[p, c, 0], circles[p, c, 1] = segments[p, middle, X], segments[p, middle, Y]
            circles[p, c, 2] = math.sqrt(square)
        first += n
    return segments, circles


@kernel
def thinned(points: Floats2, spacing: float) -> Ints:
    """Return indices of the `points` (m, 2) to keep: the first, and each at least `spacing` [m] from the last kept."""
    kept, count, last = np.empty(len(points), np.int64), 1, 0
    kept[0] = 0
    for k in range(1, len(points)):
        if math.hypot(points[k, 0] - points[last, 0], points[k, 1] - points[last, 1]) >= spacing:
            kept[count], last = k, k
            count += 1
    return kept[:count].copy()


Found = tuple[int, float, float, float]
"""Segment, squared distance [m2], length along the segment [m], and offset from its line, to the left [m]."""


@kernel
def nearest_of(segments: Floats2, n: int, begin: int, end: int, x: float, y: float, nearest: Found) -> Found:
    """Return the segment from `begin` to `end` of a path (L, 5) that is nearest to a position, or `nearest` if nearer.

    Of equally near segments, the first is taken. The path has `n` vertices.
    """
    nearest_k, best, forward, left = nearest
    for k in range(begin, end):
        unit_x, unit_y = segments[k, UNIT_X], segments[k, UNIT_Y]
        dx, dy = x - segments[k, X], y - segments[k, Y]
        along = dx * unit_x + dy * unit_y
        if k > 0:
            along = max(along, 0.0)
        if k < n - 2:
            along = min(along, segments[k + 1, S] - segments[k, S])
        off_x, off_y = dx - along * unit_x, dy - along * unit_y
        square = off_x * off_x + off_y * off_y
        if square < best or (square == best and k < nearest_k):
            nearest_k, best, forward, left = k, square, along, unit_x * dy - unit_y * dx
    return nearest_k, best, forward, left


@kernel
def nearest(paths: PathBatch, p: int, x: float, y: float) -> tuple[int, float, float]:
    """Return the nearest point of path `p` to a position in frame map [m].

    Of equally near points, the first along the path is taken. The chunk with the nearest centre is searched first, and
    others only if their circles reach nearer than the point found so far.

    Returns:
        segment and arc length [m] of the point, and the offset of the position from the segment's line, to the left
        [m].
    """
    segments, circles, n = paths.segments[p], paths.circles[p], paths.counts[p]
    chunks = (n + CHUNK - 2) // CHUNK
    first, least = 0, math.inf
    for c in range(chunks):
        dx, dy = x - circles[c, 0], y - circles[c, 1]
        square = dx * dx + dy * dy
        if square < least:
            first, least = c, square
    # the first and the last segment reach beyond their circles
    foot = nearest_of(segments, n, 0, 1, x, y, (0, math.inf, 0.0, 0.0))
    foot = nearest_of(segments, n, n - 2, n - 1, x, y, foot)
    foot = nearest_of(segments, n, first * CHUNK, min((first + 1) * CHUNK, n - 1), x, y, foot)
    distance = math.sqrt(foot[1])
    for c in range(chunks):
        dx, dy = x - circles[c, 0], y - circles[c, 1]
        reach = distance + circles[c, 2] + SLACK
        if c != first and dx * dx + dy * dy <= reach * reach:
            foot = nearest_of(segments, n, c * CHUNK, min((c + 1) * CHUNK, n - 1), x, y, foot)
            distance = math.sqrt(foot[1])
    return foot[0], segments[foot[0], S] + foot[2], foot[3]


@kernel
def _project(paths: PathBatch, path: Ints, x: Floats, y: Floats) -> tuple[Ints, Floats, Floats]:
    """See :meth:`PathBatch.project`."""
    segment, s, d = np.empty(len(path), np.int64), np.empty(len(path)), np.empty(len(path))
    for k in range(len(path)):
        segment[k], s[k], d[k] = nearest(paths, path[k], x[k], y[k])
    return segment, s, d


@kernel
def segment_at(paths: PathBatch, p: int, s: float) -> int:
    """Return the segment of path `p` at arc length `s` [m]."""
    # vertices after `high` are beyond s, or end the last segment, which is prolonged
    low, high = 0, paths.counts[p] - 2
    while low < high:
        middle = (low + high + 1) // 2
        if paths.segments[p, middle, S] <= s:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def place_at(paths: PathBatch, p: int, s: float) -> tuple[float, float, float, float]:
    """Return the place on path `p` at arc length `s` [m]: x, y [m], and the unit vector of the path there."""
    segment = segment_at(paths, p, s)
    unit_x, unit_y = paths.segments[p, segment, UNIT_X], paths.segments[p, segment, UNIT_Y]
    along = s - paths.segments[p, segment, S]
    begin_x, begin_y = paths.segments[p, segment, X], paths.segments[p, segment, Y]
    return begin_x + along * unit_x, begin_y + along * unit_y, unit_x, unit_y


@kernel
def _segments_at(paths: PathBatch, path: Ints, s: Floats) -> Ints:
    """See :meth:`PathBatch.segment`."""
    segment = np.empty(len(s), np.int64)
    for k in range(len(s)):
        segment[k] = segment_at(paths, path[k], s[k])
    return segment


@kernel
def _points_at(paths: PathBatch, path: Ints, s: Floats) -> Floats2:
    """See :meth:`PathBatch.point`."""
    segments, points = paths.segments, np.empty((len(path), 2))
    for i in range(len(path)):
        p = path[i]
        last = paths.counts[p] - 1
        for axis in (X, Y):
            if s[i] <= 0.0:
                points[i, axis] = segments[p, 0, axis] + s[i] * segments[p, 0, UNIT_X + axis]
            elif s[i] >= segments[p, last, S]:
                beyond = s[i] - segments[p, last, S]
                points[i, axis] = segments[p, last, axis] + beyond * segments[p, last - 1, UNIT_X + axis]
            else:
                k = segment_at(paths, p, s[i])
                rise = segments[p, k + 1, axis] - segments[p, k, axis]
                slope = rise / (segments[p, k + 1, S] - segments[p, k, S])
                points[i, axis] = slope * (s[i] - segments[p, k, S]) + segments[p, k, axis]
    return points


@kernel
def windows(paths: PathBatch, s: Floats, behind: float, ahead: float) -> tuple[Ints, Ints]:
    """Return the range of vertices, at least two, around arc length `s` (m,) [m] of each path.

    It begins within `behind` [m] before `s`, or with the segment at `s` if that begins earlier, and ends with the
    segment at `ahead` [m] beyond `s`.

    Returns:
        first (m,) and end (m,), exclusive.
    """
    begin, end = np.zeros(len(s), np.int64), np.zeros(len(s), np.int64)
    for p in range(len(s)):
        here = segment_at(paths, p, s[p])
        while begin[p] < here and paths.segments[p, begin[p], S] < s[p] - behind:
            begin[p] += 1
        end[p] = segment_at(paths, p, s[p] + ahead) + 2
    return begin, end


@kernel
def directions_ahead(paths: PathBatch, s: Floats, reach: Floats) -> tuple[Floats2, Floats2]:
    """Return x, y (m, 3) of directions of paths at arc lengths `s` (m,), half a `reach` and one and a half ahead."""
    unit_x, unit_y = np.empty((len(s), 3)), np.empty((len(s), 3))
    for i in range(len(s)):
        for k, share in enumerate((0.0, 0.5, 1.5)):
            segment = segment_at(paths, i, s[i] + reach[i] * share)
            unit_x[i, k], unit_y[i, k] = paths.segments[i, segment, UNIT_X], paths.segments[i, segment, UNIT_Y]
    return unit_x, unit_y
