"""Several reference paths as padded arrays, for vectorised queries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from litsim_policy.motion import path_kernels
from litsim_policy.motion.path_kernels import UNIT_X, UNIT_Y
from litsim_sim.core.scene import FloatArray, IntArray

PATH_BEHIND, PATH_AHEAD = 5.0, 150.0  # [m] of an agent's path, behind and ahead of it, that a policy is given


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


class PathBatch:
    """m polylines of up to L points, with their arc lengths; results for one do not depend on the others.

    Attributes:
        count: (m,) number of points of each, at least 2.
        segments: (m, L, 5) points, arc lengths and directions, see :mod:`litsim_policy.motion.path_kernels`.
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
        """Returns the paths at positions `rows`."""
        other = object.__new__(PathBatch)
        other.count, other.segments, other.circles = self.count[rows], self.segments[rows], self.circles[rows]
        return other

    def project(self, path: IntArray, x: FloatArray, y: FloatArray) -> Projection:
        """Project positions `x`, `y` (k,) in frame map [m] onto the paths `path` (k,), given by their indices.

        First and last segments are prolonged; of equally near points, the first along the path is taken.
        """
        return Projection(*path_kernels.project(self.segments, self.circles, self.count, path, x, y))

    @cached_property
    def arrays(self) -> path_kernels.PathArrays:
        """The paths as kernels take them."""
        return path_kernels.PathArrays(self.segments, self.circles, self.count)

    @cached_property
    def each(self) -> IntArray:
        """Indices (m,) of all paths."""
        return np.arange(len(self))

    def segment(self, s: FloatArray, path: IntArray | None = None) -> IntArray:
        """Returns segments (m, k) of the paths at arc lengths `s` (m, k) [m], with ends prolonged.

        `path` (m,) selects paths by index; None for all paths in order.
        """
        return path_kernels.segments_at(self.segments, self.count, self.each if path is None else path, s)

    def window(self, s: FloatArray) -> tuple[IntArray, IntArray]:
        """Returns the range of the path points that policies are given, for agents at arc lengths `s` (m,) [m].

        Returns:
            first (m,) and end (m,), exclusive: from PATH_BEHIND behind the agents to the end of the segment at
            PATH_AHEAD.
        """
        return path_kernels.windows(self.segments, self.count, s, PATH_BEHIND, PATH_AHEAD)

    def heading(self, path: int | IntArray, segment: IntArray) -> FloatArray:
        """Returns direction (...) [rad] of segments of the paths with indices `path`; shapes broadcast."""
        return np.arctan2(self.segments[path, segment, UNIT_Y], self.segments[path, segment, UNIT_X])

    def directions_ahead(self, s: FloatArray, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit vectors along the paths, x and y (m, 3): at `s` (m,) [m], and half a `reach` (m,) [m] and 1.5 ahead."""
        return path_kernels.directions_ahead(self.segments, self.count, s, reach)

    def point(self, s: FloatArray, path: IntArray | None = None) -> FloatArray:
        """Points (m, 2) of the paths at arc lengths `s` (m,) [m], with ends prolonged; `path` as in :meth:`segment`."""
        return path_kernels.points_at(self.segments, self.count, self.each if path is None else path, s)
