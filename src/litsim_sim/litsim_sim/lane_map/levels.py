"""Roads that pass over others: parts of a net with no way between them, which cross at different heights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.net_lanes import LEVEL, Lane

NEAR = 5.0  # [m] between centre lines up to which vehicles on two lanes could touch, if they were at one height
SPACING = 2.0  # [m] between the points of lanes that are compared


class Levels:
    """Parts of a net. Lanes are of one part if a way leads from one to the other, or if they are near at one height.

    Attributes:
        part: (lanes,) part of each lane.
        over: (parts, parts) whether one part passes over or under the other.
    """

    def __init__(self, lanes: Sequence[Lane]) -> None:
        row = {lane.id: index for index, lane in enumerate(lanes)}
        edges = {lane.edge_id: index for index, lane in enumerate(lanes)}
        links = [(row[lane.id], row[name]) for lane in lanes for name in lane.successors]
        links += [(row[lane.id], edges[lane.edge_id]) for lane in lanes]
        self.part = _parts(np.array(links), len(lanes))
        lane, height, pairs = _near_points(lanes, self.part)
        level = np.abs(height[pairs[:, 0]] - height[pairs[:, 1]]) < LEVEL
        self.part = _parts(np.concatenate([links, lane[pairs[level]]]), len(lanes))
        a, b = self.part[lane[pairs[~level]]].T
        self.over: BoolArray = np.zeros((self.part.max() + 1,) * 2, np.bool_)
        self.over[a, b] = self.over[b, a] = a != b

    def apart_from(self, own: int) -> BoolArray:
        """Returns the mask (parts,) of those to leave out around the part `own`, so that none passes over another."""
        apart: BoolArray = self.over[own].copy()
        for part in range(len(apart)):
            if not apart[part] and part != own:
                apart |= self.over[part]
                apart[own] = False
        return apart


def _parts(links: IntArray, count: int) -> IntArray:
    """Returns the parts (count,) that `links` (k, 2) between lanes make."""
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _near_points(lanes: Sequence[Lane], part: IntArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Returns lane (n,) and height (n,) [m] of points of lanes, and pairs (k, 2) of near ones of different parts."""
    places, heights, of = [], [], []
    for index, lane in enumerate(lanes):
        s = np.linspace(0.0, lane.length, 2 + int(lane.length / SPACING))
        places.append(np.column_stack([np.interp(s, lane.s, axis) for axis in lane.centerline.T]))
        heights.append(np.zeros(len(s)) if lane.heights is None else np.interp(s, lane.s, lane.heights))
        of.append(np.full(len(s), index))
    lane_of = np.concatenate(of)
    pairs = KDTree(np.concatenate(places)).query_pairs(NEAR, output_type="ndarray")
    return lane_of, np.concatenate(heights), pairs[part[lane_of[pairs[:, 0]]] != part[lane_of[pairs[:, 1]]]]
