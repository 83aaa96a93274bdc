"""Compiled loops over polylines: layout, nearest points, and points at arc lengths.

The kernels take m polylines as one array (m, L, 5), `segments`. Row [p, k] is vertex k of path p and the segment that
begins there: x, y [m], arc length from the first vertex [m], and the unit vector of the segment. Path p has `count[p]`
vertices, at least 2; entries after them are meaningless, as is the unit vector of the last. First and last
segments count as prolonged without end.

Circles (m, C, 3) enclose chunks of CHUNK segments each: centre x, y, which is a vertex, and radius [m]. They bound the
distance of the segments to a position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from litsim_sim.kernels.compiled import Floats, Floats2, Floats3, Ints, Ints2, kernel

CHUNK = 8  # segments in a circle
SLACK = 1e-6  # [m] by which circles are widened, for rounding
X, Y, S, UNIT_X, UNIT_Y = range(5)  # columns of `segments`


class PathArrays(NamedTuple):
    """Paths as described above."""

    segments: Floats3
    circles: Floats3
    counts: Ints


@kernel
def lay_out(points: Floats2, count: Ints) -> tuple[Floats3, Floats3]:
    """Return `segments` and circles of polylines.

    Args:
        points: (N, 2) of all polylines, one after the other, in frame map [m].
        count: (m,) number of points of each.
    """
    longest = 2
    for n in count:
        longest = max(longest, n)
    segments = np.empty((len(count), longest, 5))
    circles = np.empty((len(count), (longest + CHUNK - 2) // CHUNK, 3))
    first = 0
    for p in range(len(count)):
        n = count[p]
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
    kept, found, last = np.empty(len(points), np.int64), 1, 0
    kept[0] = 0
    for k in range(1, len(points)):
        if math.hypot(points[k, 0] - points[last, 0], points[k, 1] - points[last, 1]) >= spacing:
            kept[found], last = k, k
            found += 1
    return kept[:found].copy()


Found = tuple[int, float, float, float]
"""Segment, squared distance [m2], length along the segment [m], and offset from its line, to the left [m]."""


@kernel
def nearest_of(segments: Floats2, n: int, begin: int, end: int, x: float, y: float, found: Found) -> Found:
    """Return the segment from `begin` to `end` of a path (L, 5) that is nearest to a position, or `found` if nearer.

    Of equally near segments, the first is taken. The path has `n` vertices.
    """
    nearest_k, best, forward, left = found
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
def nearest(segments: Floats2, circles: Floats2, n: int, x: float, y: float) -> tuple[int, float, float]:
    """Return the nearest point of a path (L, 5), which has `n` vertices, to a position in frame map [m].

    Of equally near points, the first along the path is taken. The chunk with the nearest centre is searched first, and
    others only if their circles (C, 3) reach nearer than the point found so far.

    Returns:
        segment and arc length [m] of the point, and the offset of the position from the segment's line, to the left
        [m].
    """
    chunks = (n + CHUNK - 2) // CHUNK
    first, least = 0, math.inf
    for c in range(chunks):
        dx, dy = x - circles[c, 0], y - circles[c, 1]
        square = dx * dx + dy * dy
        if square < least:
            first, least = c, square
    # the first and the last segment reach beyond their circles
    found = nearest_of(segments, n, 0, 1, x, y, (0, math.inf, 0.0, 0.0))
    found = nearest_of(segments, n, n - 2, n - 1, x, y, found)
    found = nearest_of(segments, n, first * CHUNK, min((first + 1) * CHUNK, n - 1), x, y, found)
    distance = math.sqrt(found[1])
    for c in range(chunks):
        dx, dy = x - circles[c, 0], y - circles[c, 1]
        reach = distance + circles[c, 2] + SLACK
        if c != first and dx * dx + dy * dy <= reach * reach:
            found = nearest_of(segments, n, c * CHUNK, min((c + 1) * CHUNK, n - 1), x, y, found)
            distance = math.sqrt(found[1])
    return found[0], segments[found[0], S] + found[2], found[3]


@kernel
def project(
    segments: Floats3, circles: Floats3, count: Ints, path: Ints, x: Floats, y: Floats
) -> tuple[Ints, Floats, Floats]:
    """Return segments, arc lengths and offsets (k,) of :func:`nearest` for k positions on the paths `path` (k,)."""
    segment, s, d = np.empty(len(path), np.int64), np.empty(len(path)), np.empty(len(path))
    for k in range(len(path)):
        segment[k], s[k], d[k] = nearest(segments[path[k]], circles[path[k]], count[path[k]], x[k], y[k])
    return segment, s, d


@kernel
def segment_at(segments: Floats3, n: int, p: int, s: float) -> int:
    """Return the segment of path `p`, which has `n` vertices, at arc length `s` [m]."""
    low, high = 0, n - 2  # vertices after `high` are beyond s, or end the last segment, which is prolonged
    while low < high:
        middle = (low + high + 1) // 2
        if segments[p, middle, S] <= s:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def place_at(paths: PathArrays, p: int, s: float) -> tuple[float, float, float, float]:
    """Return the place on path `p` at arc length `s` [m]: x, y [m], and the unit vector of the path there."""
    at = segment_at(paths.segments, paths.counts[p], p, s)
    unit_x, unit_y = paths.segments[p, at, UNIT_X], paths.segments[p, at, UNIT_Y]
    along = s - paths.segments[p, at, S]
    return paths.segments[p, at, X] + along * unit_x, paths.segments[p, at, Y] + along * unit_y, unit_x, unit_y


@kernel
def segments_at(segments: Floats3, count: Ints, path: Ints, s: Floats2) -> Ints2:
    """Return the segments (m, k) of the paths `path` (m,) at arc lengths `s` (m, k) [m]."""
    found = np.empty(s.shape, np.int64)
    for i in range(s.shape[0]):
        for k in range(s.shape[1]):
            found[i, k] = segment_at(segments, count[path[i]], path[i], s[i, k])
    return found


@kernel
def points_at(segments: Floats3, count: Ints, path: Ints, s: Floats) -> Floats2:
    """Return the points (m, 2) of the paths `path` (m,) at arc lengths `s` (m,) [m]."""
    found = np.empty((len(path), 2))
    for i in range(len(path)):
        p = path[i]
        last = count[p] - 1
        for axis in (X, Y):
            if s[i] <= 0.0:
                found[i, axis] = segments[p, 0, axis] + s[i] * segments[p, 0, UNIT_X + axis]
            elif s[i] >= segments[p, last, S]:
                beyond = s[i] - segments[p, last, S]
                found[i, axis] = segments[p, last, axis] + beyond * segments[p, last - 1, UNIT_X + axis]
            else:
                k = segment_at(segments, count[p], p, s[i])
                rise = segments[p, k + 1, axis] - segments[p, k, axis]
                slope = rise / (segments[p, k + 1, S] - segments[p, k, S])
                found[i, axis] = slope * (s[i] - segments[p, k, S]) + segments[p, k, axis]
    return found


@kernel
def windows(segments: Floats3, count: Ints, s: Floats, behind: float, ahead: float) -> tuple[Ints, Ints]:
    """Return the range of vertices, at least two, around arc length `s` (m,) [m] of each path.

    It begins within `behind` [m] before `s`, or with the segment at `s` if that begins earlier, and ends with the
    segment at `ahead` [m] beyond `s`.

    Returns:
        first (m,) and end (m,), exclusive.
    """
    begin, end = np.zeros(len(count), np.int64), np.zeros(len(count), np.int64)
    for p in range(len(count)):
        here = segment_at(segments, count[p], p, s[p])
        while begin[p] < here and segments[p, begin[p], S] < s[p] - behind:
            begin[p] += 1
        end[p] = segment_at(segments, count[p], p, s[p] + ahead) + 2
    return begin, end


@kernel
def directions_ahead(segments: Floats3, count: Ints, s: Floats, reach: Floats) -> tuple[Floats2, Floats2]:
    """Return directions of m paths where agents are, and half a reach and one and a half ahead.

    Args:
        segments, count: of the paths, see the module.
        s, reach: (m,) arc lengths of the agents and their pursuit reaches [m].

    Returns:
        x and y (m, 3) of unit vectors.
    """
    unit_x, unit_y = np.empty((len(s), 3)), np.empty((len(s), 3))
    for i in range(len(s)):
        for k, share in enumerate((0.0, 0.5, 1.5)):
            at = segment_at(segments, count[i], i, s[i] + reach[i] * share)
            unit_x[i, k], unit_y[i, k] = segments[i, at, UNIT_X], segments[i, at, UNIT_Y]
    return unit_x, unit_y
