"""Several reference paths as padded arrays, so that questions about all of them are answered at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from litsim_policy.motion import path_kernels
from litsim_policy.motion.path_kernels import UNIT_X, UNIT_Y
from litsim_sim.core.quickly_made import quickly_made
from litsim_sim.core.scene import FloatArray, IntArray

PATH_BEHIND, PATH_AHEAD = 5.0, 150.0  # [m] of a path before and beyond an agent that a policy is given


@quickly_made
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
    """m polylines of up to L points, with their arc lengths; results for one do not depend on the others.

    Attributes:
        count: (m,) number of points of each, at least 2.
        segments: (m, L, 5) points, arc lengths and directions, as :mod:`litsim_policy.motion.path_kernels` has them.
        circles: (m, C, 3) around chunks of segments, likewise.
    """

    def __init__(self, polylines: Sequence[FloatArray]) -> None:
        """Lay out `polylines`, arrays (k, 2) of at least two points in frame map [m], no two neighbours equal."""
        self.count = np.array([len(points) for points in polylines], np.int64)
        points = np.concatenate(polylines) if len(polylines) else np.empty((0, 2))
        self.segments, self.circles = path_kernels.lay_out(points, self.count)

    def __len__(self) -> int:
        return len(self.count)

    def take(self, rows: IntArray) -> PathBatch:
        """The paths at positions `rows`."""
        other = object.__new__(PathBatch)
        other.count, other.segments, other.circles = self.count[rows], self.segments[rows], self.circles[rows]
        return other

    def project(self, path: IntArray, x: FloatArray, y: FloatArray) -> Projection:
        """Nearest point of the path at position `path` (k,) to each place `x`, `y` (k,) in frame map [m].

        First and last segments are prolonged; of points that are equally near, the first along the path is taken.
        """
        return Projection(*path_kernels.project(self.segments, self.circles, self.count, path, x, y))

    @cached_property
    def each(self) -> IntArray:
        """(m,) positions of all paths."""
        return np.arange(len(self))

    def segment(self, s: FloatArray, path: IntArray | None = None) -> IntArray:
        """(m, k) segment of each path at arc lengths `s` (m, k) [m] of it; the ends count as prolonged.

        Where `path` (m,) is given, of the paths at these positions.
        """
        return path_kernels.segments_at(self.segments, self.count, self.each if path is None else path, s)

    def window(self, s: FloatArray) -> tuple[IntArray, IntArray]:
        """Which points of the paths are given to policies whose agents are at arc lengths `s` (m,) [m].

        Returns:
            the first (m,) and the one behind the last (m,): the points from PATH_BEHIND before the agents on, and those
            of the segments up to PATH_AHEAD.
        """
        return path_kernels.windows(self.segments, self.count, s, PATH_BEHIND, PATH_AHEAD)

    def heading(self, path: int | IntArray, segment: IntArray) -> FloatArray:
        """(...) direction [rad] of segments, of paths at positions `path`; shapes broadcast."""
        return np.arctan2(self.segments[path, segment, UNIT_Y], self.segments[path, segment, UNIT_X])

    def point(self, s: FloatArray, path: IntArray | None = None) -> FloatArray:
        """(m, 2) point of each path at arc length `s` (m,) of it [m], ends prolonged; `path` as in :meth:`segment`."""
        return path_kernels.points_at(self.segments, self.count, self.each if path is None else path, s)
