"""Centre lines of lanes as paths of the agents on them, made on first use."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np

from litsim_policy.motion.path_batch import PathBatch, nearest
from litsim_policy.motion.reference_path import BEYOND, ReferencePath
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Bools2, Floats, Ints, kernel
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane

NO_LANE = -1  # in place of the position of a lane in `LaneMap.lanes`
FAR = 1000.0  # [m] distance ahead beyond which no caller needs the lanes
BEFORE = 150.0  # [m] by which the line of a lane begins before the lane, to include agents that approach it


class LaneLines:
    """Centre lines of the lanes of a net, from BEFORE their beginnings on; independent of runs.

    Attributes:
        batch: the lines used so far; see :meth:`rows`.
        left, right: (lanes,) row of the adjacent lane in the same edge; NO_LANE if there is none.
        road: (lanes,) a number for the edge of each lane.
    """

    def __init__(self, lane_map: LaneMap) -> None:
        self._lane_map = lane_map
        self._row: IntArray = np.full(len(lane_map.lanes), NO_LANE)  # in `batch`, of lanes used so far
        self._points: list[FloatArray] = []
        self.batch = PathBatch.of([])
        self.left = _neighbours(lane_map, (lane.left for lane in lane_map.lanes))
        self.right = _neighbours(lane_map, (lane.right for lane in lane_map.lanes))
        self.road = np.unique([lane.edge_id for lane in lane_map.lanes], return_inverse=True)[1]

    def rows(self, lanes: IntArray) -> IntArray:
        """Returns positions (k,) in `batch` of the lines of `lanes` (k,), positions in `LaneMap.lanes`."""
        missing = lanes[self._row[lanes] < 0]
        if len(missing):
            for lane in dict.fromkeys(missing.tolist()):
                self._row[lane] = len(self._points)
                self._points.append(self._line(lane))
            self.batch = PathBatch.of(self._points)
        return self._row[lanes]

    def beside(self, lanes: IntArray, others: IntArray) -> FloatArray:
        """Distance (k,) [m] from the beginnings of `lanes` (k,) over which `others` (k,) stay their neighbours.

        Both are followed along the straightest way, across junctions, until one ends or they part; infinite if both
        leave the net side by side, or stay adjacent for FAR.
        """
        left = self.left[lanes] == others
        return np.where(left, self._left_beside[lanes], self._right_beside[lanes])

    @cached_property
    def _left_beside(self) -> FloatArray:
        return np.array([self._side_by_side(lane, other) for lane, other in enumerate(self.left.tolist())])

    @cached_property
    def _right_beside(self) -> FloatArray:
        return np.array([self._side_by_side(lane, other) for lane, other in enumerate(self.right.tolist())])

    def _side_by_side(self, lane: int, other: int) -> float:
        """See :meth:`beside`, for one lane and a neighbour."""
        if other == NO_LANE:
            return 0.0
        lanes, side = self._lane_map.lanes, self.left if self.left[lane] == other else self.right
        length = lanes[lane].length
        while length < FAR:
            (ahead, inside), (beside, _) = self._lane_map.road_ahead(lane), self._lane_map.road_ahead(other)
            if ahead is None and beside is None:
                return np.inf
            if ahead is None or beside is None or side[ahead] != beside:
                return length
            lane, other, length = ahead, beside, length + inside + lanes[ahead].length
        return np.inf

    def width(self, lanes: IntArray) -> FloatArray:
        """Returns widths (k,) of `lanes` (k,) [m]."""
        return self._lane_map.widths[lanes]

    def inside(
        self, lanes: IntArray, rows: IntArray, places: tuple[FloatArray, FloatArray], first: IntArray, most: int
    ) -> BoolArray:
        """Returns the mask (k, w) of agents that are between the edges of each of `lanes` (k,).

        Agents are in `rows` (r,), ascending, at `places` x, y (r,) [m]. Column 0 is the agent in row `first`
        (k,), of w = `most`.
        """
        line = self.rows(lanes)  # which may change `batch`
        return _inside(self.batch, line, 0.5 * self.width(lanes), rows, places, first, most)

    @cached_property
    def _predecessor(self) -> dict[int, int]:
        """The first predecessor of each lane that has one, by row."""
        predecessors: dict[int, int] = {}
        for row, lane in enumerate(self._lane_map.lanes):
            for name in lane.successors:
                predecessors.setdefault(self._lane_map.row(name), row)
        return predecessors

    def _line(self, lane: int) -> FloatArray:
        """Returns points (m, 2) [m]: BEFORE of the predecessors, the lane, and BEYOND of its continuation."""
        parts, first, left = [], lane, BEFORE
        while left > 0.0 and first in self._predecessor:
            first = self._predecessor[first]
            before = self._lane_map.lanes[first]
            begin = max(0.0, before.length - left)
            start = np.stack(self._lane_map.pose_at(first, begin)[:2], axis=-1)[None]
            parts.append(np.concatenate([start, before.centerline[before.s > begin]]))
            left -= before.length
        length = self._lane_map.lanes[lane].length + BEYOND
        parts = [*parts[::-1], self._lane_map.path_from(lane, 0.0, length)]
        return ReferencePath.through(np.concatenate(parts)).points


def _neighbours(lane_map: LaneMap, names: Iterable[str | None]) -> IntArray:
    """Rows (lanes,) of the lanes called `names`; NO_LANE for None, and in junctions, which have no lane changes."""
    lanes: tuple[Lane, ...] = lane_map.lanes
    return np.array(
        [
            NO_LANE if name is None or lane.is_internal else lane_map.row(name)
            for name, lane in zip(names, lanes, strict=True)
        ],
        np.int64,
    )


@kernel
def _inside(
    lines: PathBatch,
    line: Ints,
    half_width: Floats,
    rows: Ints,
    places: tuple[Floats, Floats],
    first: Ints,
    most: int,
) -> Bools2:
    """See :meth:`LaneLines.inside`; lanes have their lines at positions `line` (k,), and half widths (k,) [m]."""
    x, y = places
    inside = np.zeros((len(line), most), np.bool_)
    for k in range(len(line)):
        for i in range(np.searchsorted(rows, first[k]), np.searchsorted(rows, first[k] + most)):
            inside[k, rows[i] - first[k]] = abs(nearest(lines, line[k], x[i], y[i])[2]) < half_width[k]
    return inside
