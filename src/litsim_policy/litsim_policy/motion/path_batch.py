"""Several reference paths as padded arrays, so that questions about all of them are answered at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import BoolArray, FloatArray, IntArray

CHUNK = 8  # segments that are bounded together
FAR = 1e9  # [m] in x and y, where padding lies
SLACK = 1e-6  # [m] by which bounds are widened, for rounding
PATH_BEHIND, PATH_AHEAD = 5.0, 150.0  # [m] of a path before and beyond an agent that a policy is given


@dataclass(frozen=True)
class Projection:
    """Nearest points of paths to places; arrays (k,).

    Attributes:
        segment: of the path that the nearest point lies on.
        s: arc length of it [m], negative before the path and more than its length beyond.
        d: offset of the place from the line of the segment, positive to the left [m].
    """

    segment: IntArray
    s: FloatArray
    d: FloatArray


class PathBatch:
    """m polylines of up to L points, with their arc lengths; all that is asked of them is vectorised.

    Everything comes out as for one polyline alone (:class:`litsim_policy.motion.reference_path.ReferencePath`),
    whatever the others are.

    Attributes:
        count: (m,) number of points of each, at least 2.
        points: (m, L, 2) in frame map [m], the last one repeated as padding.
        s: (m, L) arc length from the first point [m], the last one repeated.
    """

    def __init__(self, polylines: Sequence[FloatArray]) -> None:
        """Pad `polylines`, arrays (k, 2) of at least two points in frame map [m], no two neighbours equal."""
        self.count = np.array([len(points) for points in polylines], np.int64)
        chunks = -(-(int(self.count.max(initial=2)) - 1) // CHUNK)
        first = np.cumsum(self.count) - self.count
        at = first[:, None] + np.minimum(np.arange(chunks * CHUNK + 1), self.count[:, None] - 1)
        self.points = (np.concatenate(polylines) if len(polylines) else np.empty((0, 2)))[at]
        steps = self.points[:, 1:] - self.points[:, :-1]
        self.s = np.zeros(at.shape)
        np.cumsum(np.hypot(steps[..., 0], steps[..., 1]), axis=1, out=self.s[:, 1:])
        self._length = self.s[:, 1:] - self.s[:, :-1]
        used = np.arange(chunks * CHUNK) < self.count[:, None] - 1
        self._unit = steps / np.where(used, self._length, 1.0)[..., None]
        self._chunks = self._chunked(used)
        self._middle, self._radius = self._circles(used)
        self._last_chunk = (self.count - 2) // CHUNK

    def __len__(self) -> int:
        return len(self.count)

    def take(self, rows: IntArray) -> PathBatch:
        """The paths at positions `rows`."""
        other = object.__new__(PathBatch)
        other.__dict__.update({name: values[rows] for name, values in self.__dict__.items()})
        return other

    def project(self, path: IntArray, x: FloatArray, y: FloatArray) -> Projection:
        """Nearest point of the path at position `path` (k,) to each place `x`, `y` (k,) in frame map [m].

        First and last segments are prolonged; of points that are equally near, the first along the path is taken.
        Circles around chunks of segments decide which chunks can hold the nearest point; only those are looked into.
        """
        if not len(path):
            return Projection(np.empty(0, np.int64), np.empty(0), np.empty(0))
        place, chunk = np.nonzero(self._can_be_nearest(path, x, y))
        values = self._chunks[path[place], chunk]
        unit_x, unit_y = values[:, 2], values[:, 3]
        dx, dy = x[place, None] - values[:, 0], y[place, None] - values[:, 1]
        t = np.minimum(np.maximum(dx * unit_x + dy * unit_y, values[:, 4]), values[:, 5])
        square = (dx - t * unit_x) ** 2 + (dy - t * unit_y) ** 2
        within, each, all_places = square.argmin(axis=1), np.arange(len(place)), np.arange(len(path))
        square = square[each, within]
        least = np.minimum.reduceat(square, place.searchsorted(all_places))
        winners = np.flatnonzero(square == least[place])
        best = winners[place[winners].searchsorted(all_places)]
        inner = within[best]
        segment = chunk[best] * CHUNK + inner
        left = unit_x[best, inner] * dy[best, inner] - unit_y[best, inner] * dx[best, inner]
        return Projection(segment, self.s[path, segment] + t[best, inner], left)

    def segment(self, s: FloatArray) -> IntArray:
        """(m, ...) segment of each path at arc lengths `s` (m, ...) [m] of it; the ends count as prolonged."""
        others = tuple(range(1, s.ndim))
        before = (np.expand_dims(self.s, others) <= s[..., None]).sum(axis=-1)
        return np.clip(before - 1, 0, np.expand_dims(self.count - 2, others))

    def window(self, s: FloatArray) -> tuple[IntArray, IntArray]:
        """Which points of the paths are given to policies whose agents are at arc lengths `s` (m,) [m].

        Returns:
            the first (m,) and the one behind the last (m,): the points from PATH_BEHIND to PATH_AHEAD; the last two
            points of the path, where fewer than two are.
        """
        begin = (self.s < s[:, None] - PATH_BEHIND).sum(axis=1)
        end = np.minimum((self.s <= s[:, None] + PATH_AHEAD).sum(axis=1), self.count)
        enough = end - begin >= 2
        return np.where(enough, begin, self.count - 2), np.where(enough, end, self.count)

    def heading(self, path: IntArray, segment: IntArray) -> FloatArray:
        """(...) direction [rad] of segments, of paths at positions `path`; shapes broadcast."""
        unit = self._unit[path, segment]
        return np.arctan2(unit[..., 1], unit[..., 0])

    def point(self, s: FloatArray) -> FloatArray:
        """(m, 2) point of each path at arc length `s` (m,) of it [m], ends prolonged."""
        rows, last = np.arange(len(self)), self.count - 1
        at = self.segment(s)
        begin, end = self.points[rows, at], self.points[rows, at + 1]
        slope = (end - begin) / self._length[rows, at][:, None]
        inner = slope * (s - self.s[rows, at])[:, None] + begin
        before = self.points[:, 0] + s[:, None] * self._unit[:, 0]
        beyond = self.points[rows, last] + (s - self.s[rows, last])[:, None] * self._unit[rows, last - 1]
        return np.where((s <= 0.0)[:, None], before, np.where((s >= self.s[rows, last])[:, None], beyond, inner))

    def _chunked(self, used: BoolArray) -> FloatArray:
        """(m, C, 6, CHUNK) start x and y, unit x and y, lowest and highest place along, of segments that are `used`."""
        rows, chunks = len(self), used.shape[1] // CHUNK
        low, high = np.zeros(used.shape), self._length.copy()
        low[:, 0], high[np.arange(rows), self.count - 2] = -np.inf, np.inf
        start = np.where(used[..., None], self.points[:, :-1], FAR)
        found = np.empty((rows, chunks, 6, CHUNK))
        columns = (start[..., 0], start[..., 1], self._unit[..., 0], self._unit[..., 1], low, high)
        for k, values in enumerate(columns):
            found[:, :, k] = values.reshape(rows, chunks, CHUNK)
        return found

    def _circles(self, used: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Circles that hold the chunks: centres (m, 2, C), which are vertices, and radii (m, C) [m]."""
        shape = (len(self), used.shape[1] // CHUNK, CHUNK, 2)
        middle = self.points[:, CHUNK // 2 :: CHUNK]
        away = self.points[:, :-1].reshape(shape) - middle[:, :, None]
        last = self.points[:, CHUNK::CHUNK] - middle
        square = np.maximum((away**2).sum(axis=-1).max(axis=-1, initial=0.0), (last**2).sum(axis=-1))
        middle = np.where(used[:, ::CHUNK, None], middle, FAR)
        return np.ascontiguousarray(middle.transpose(0, 2, 1)), np.sqrt(square) + SLACK

    def _can_be_nearest(self, path: IntArray, x: FloatArray, y: FloatArray) -> BoolArray:
        """(k, C) which chunks can hold the nearest point to each place."""
        middle = self._middle[path]
        dx, dy = x[:, None] - middle[:, 0], y[:, None] - middle[:, 1]
        to_middle = np.sqrt(dx * dx + dy * dy)
        to_first, to_last = self._beyond(path, x, y)
        within = np.minimum(np.minimum(to_first, to_last), to_middle.min(axis=1)) + SLACK
        near = to_middle - self._radius[path] <= within[:, None]
        near[:, 0] |= to_first <= within
        near[np.arange(len(path)), self._last_chunk[path]] |= to_last <= within
        return near

    def _beyond(self, path: IntArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """(2, k) distance [m] of places to the rays that prolong the first and the last segment."""
        rows, last = np.arange(len(self)), self.count - 1
        end = np.stack([self.points[:, 0], self.points[rows, last]])[:, path]
        unit = np.stack([-self._unit[:, 0], self._unit[rows, last - 1]])[:, path]
        dx, dy = x - end[..., 0], y - end[..., 1]
        t = np.maximum(dx * unit[..., 0] + dy * unit[..., 1], 0.0)
        return np.sqrt((dx - t * unit[..., 0]) ** 2 + (dy - t * unit[..., 1]) ** 2)
