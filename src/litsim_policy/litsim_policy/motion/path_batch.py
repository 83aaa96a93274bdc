"""Several reference paths as padded arrays, so that questions about all of them are answered at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import FloatArray, IntArray

CHUNK = 8  # segments that are bounded together
FAR = 1e9  # [m] in x and y, where padding lies
SLACK = 1e-6  # [m] by which bounds are widened, for rounding


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
        longest = int(self.count.max(initial=2))
        first = np.cumsum(self.count) - self.count
        at = first[:, None] + np.minimum(np.arange(longest), self.count[:, None] - 1)
        flat = np.concatenate(polylines) if len(polylines) else np.empty((0, 2))
        self.points = flat[at]
        steps = np.diff(self.points, axis=1)
        self.s = np.zeros(at.shape)
        np.cumsum(np.hypot(steps[..., 0], steps[..., 1]), axis=1, out=self.s[:, 1:])
        self._length = np.diff(self.s, axis=1)
        used = np.arange(longest - 1) < self.count[:, None] - 1
        self._unit = steps / np.where(used, self._length, 1.0)[..., None]
        self._bound(used)

    def __len__(self) -> int:
        return len(self.count)

    def project(self, path: IntArray, x: FloatArray, y: FloatArray) -> Projection:
        """Nearest point of the path at position `path` (k,) to each place `x`, `y` (k,) in frame map [m].

        First and last segments are prolonged; of points that are equally near, the first along the path is taken.
        Circles around chunks of segments decide which chunks can hold the nearest point; only those are looked into.
        """
        if not len(path):
            return Projection(np.empty(0, np.int64), np.empty(0), np.empty(0))
        place, chunk = np.nonzero(self._can_be_nearest(path, x, y))
        of = path[place]
        start_x, start_y, unit_x, unit_y, low, high = np.moveaxis(self._chunks[of, chunk], 1, 0)
        dx, dy = x[place, None] - start_x, y[place, None] - start_y
        t = np.minimum(np.maximum(dx * unit_x + dy * unit_y, low), high)
        square = (dx - t * unit_x) ** 2 + (dy - t * unit_y) ** 2
        within = np.argmin(square, axis=1)
        each = np.arange(len(place))
        square = square[each, within]
        least = np.minimum.reduceat(square, np.searchsorted(place, np.arange(len(path))))
        winners = np.flatnonzero(square == least[place])
        best = winners[np.searchsorted(place[winners], np.arange(len(path)))]
        inner = within[best]
        segment = chunk[best] * CHUNK + inner
        left = unit_x[best, inner] * dy[best, inner] - unit_y[best, inner] * dx[best, inner]
        return Projection(segment, self.s[path, segment] + t[best, inner], left)

    def segment(self, s: FloatArray) -> IntArray:
        """(m, ...) segment of each path at arc lengths `s` (m, ...) [m] of it; the ends count as prolonged."""
        ahead = s.reshape(len(self), -1)
        at = (self.s[:, None, :] <= ahead[:, :, None]).sum(axis=2) - 1
        return np.clip(at, 0, self.count[:, None] - 2).reshape(s.shape)

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

    def _bound(self, used: np.ndarray) -> None:
        """Put the segments into chunks, and circles around those; `used` (m, L - 1) is False for padding."""
        rows, spare = np.arange(len(self)), -used.shape[1] % CHUNK
        low, high = np.zeros(used.shape), self._length.copy()
        low[:, 0], high[rows, self.count - 2] = -np.inf, np.inf
        start = np.where(used[..., None], self.points[:, :-1], FAR)
        fields = [start[..., 0], start[..., 1], self._unit[..., 0], self._unit[..., 1], low, high]
        pads = (FAR, FAR, 0.0, 0.0, 0.0, 0.0)
        padded = [np.pad(v, ((0, 0), (0, spare)), constant_values=pad) for v, pad in zip(fields, pads, strict=True)]
        shape = (len(self), padded[0].shape[1] // CHUNK, CHUNK)
        self._chunks = np.ascontiguousarray(np.stack([values.reshape(shape) for values in padded], axis=2))
        begins = np.arange(0, used.shape[1], CHUNK)
        corners = np.minimum(begins[:, None] + np.arange(CHUNK + 1), self.count[:, None, None] - 1)
        points = self.points[rows[:, None, None], corners]
        middle = points[:, :, CHUNK // 2]
        away = points - middle[:, :, None]
        self._radius = np.hypot(away[..., 0], away[..., 1]).max(axis=2, initial=0.0) + SLACK
        empty = begins[None, :] > self.count[:, None] - 2
        self._middle_x = np.where(empty, FAR, middle[..., 0])
        self._middle_y = np.where(empty, FAR, middle[..., 1])
        self._last_chunk = (self.count - 2) // CHUNK

    def _can_be_nearest(self, path: IntArray, x: FloatArray, y: FloatArray) -> np.ndarray:
        """(k, chunks) which chunks can hold the nearest point to each place."""
        dx, dy = x[:, None] - self._middle_x[path], y[:, None] - self._middle_y[path]
        to_middle = np.sqrt(dx * dx + dy * dy)
        last = self.count[path] - 1
        to_first = self._beyond(path, 0, 0, -1.0, x, y)
        to_last = self._beyond(path, last, last - 1, 1.0, x, y)
        within = np.minimum(np.minimum(to_first, to_last), to_middle.min(axis=1)) + SLACK
        near = to_middle - self._radius[path] <= within[:, None]
        near[:, 0] |= to_first <= within
        near[np.arange(len(path)), self._last_chunk[path]] |= to_last <= within
        return near

    def _beyond(
        self, path: IntArray, corner: int | IntArray, segment: int | IntArray, sign: float, x: FloatArray, y: FloatArray
    ) -> FloatArray:
        """(k,) distance [m] of places to the ray that prolongs an end segment from the point `corner` on."""
        end, unit = self.points[path, corner], sign * self._unit[path, segment]
        dx, dy = x - end[:, 0], y - end[:, 1]
        t = np.maximum(dx * unit[:, 0] + dy * unit[:, 1], 0.0)
        return np.sqrt((dx - t * unit[:, 0]) ** 2 + (dy - t * unit[:, 1]) ** 2)
