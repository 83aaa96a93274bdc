"""Features of the lane that an agent is in, for the observations of policy C and of the imitated traffic.

The features (7): left and right lane marking, left and right road edge, lane offset, curvature, heading to the lane.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from litsim_policy.driving.features.scales import CURVATURE, EDGE, HEADING, LATERAL
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.kernels.compiled import FLOATS, FLOATS2, INTS, OUT_FLOATS2, int64, kernel, void
from litsim_sim.lane_map.lane_map import LaneMap

ROAD = 7  # number of these features
CURVE_LENGTH = 10.0  # [m] length of lane around the agent over which its curvature is measured


class LaneFeatures:
    """The ROAD features of agents: markings, edges, offset and heading in the lane, and its curvature."""

    def __init__(self, lane_map: LaneMap) -> None:
        self._lane_map = lane_map
        lanes = lane_map.lanes
        self._half_width = 0.5 * np.array([lane.width for lane in lanes])
        self._to_left = np.array([_width_beyond(lane_map, row, "left") for row in range(len(lanes))])
        self._to_right = np.array([_width_beyond(lane_map, row, "right") for row in range(len(lanes))])

    def write(self, agents: PathFollowers, first: int, features: FloatArray) -> None:
        """Write the features of `agents` into `features` (m, size), from the position `first` on."""
        at = agents.lane
        around = self._lane_map.headings_around(at.lane, at.s, 0.5 * CURVE_LENGTH)
        sides = self._half_width, self._to_left, self._to_right
        _write(at.lane, at.d, at.heading, around, agents.yaw, *sides, first, features)


@kernel(void(INTS, FLOATS, FLOATS, FLOATS2, FLOATS, FLOATS, FLOATS, FLOATS, int64, OUT_FLOATS2))
def _write(  # noqa: PLR0917 - a kernel takes arrays and numbers
    lane: IntArray,
    d: FloatArray,
    lane_heading: FloatArray,
    around: FloatArray,
    yaw: FloatArray,
    half_width: FloatArray,
    to_left: FloatArray,
    to_right: FloatArray,
    first: int,
    features: FloatArray,
) -> None:
    """Write the ROAD features of m agents.

    Args:
        lane, d, lane_heading: (m,) as in :class:`litsim_sim.lane_map.lane_map.LanePosition`.
        around: (m, 2) heading of the lane half of CURVE_LENGTH behind and ahead [rad].
        yaw: (m,) of the agents [rad].
        half_width: of all lanes [m].
        to_left, to_right: width of the road beyond each lane [m].
        first: position of the first feature.
        features: (m, size) written to.
    """
    for i in range(len(lane)):
        marker_left, marker_right = half_width[lane[i]] - d[i], half_width[lane[i]] + d[i]
        features[i, first] = marker_left / LATERAL
        features[i, first + 1] = marker_right / LATERAL
        features[i, first + 2] = (marker_left + to_left[lane[i]]) / EDGE
        features[i, first + 3] = (marker_right + to_right[lane[i]]) / EDGE
        features[i, first + 4] = d[i] / LATERAL
        features[i, first + 5] = wrapped(around[i, 1] - around[i, 0]) / CURVE_LENGTH / CURVATURE
        features[i, first + 6] = wrapped(yaw[i] - lane_heading[i]) / HEADING


def _width_beyond(lane_map: LaneMap, row: int, side: Literal["left", "right"]) -> float:
    """Width [m] of the lanes of the same edge beyond the lane in `row`, on that side."""
    width, beside = 0.0, getattr(lane_map.lanes[row], side)
    while beside is not None:
        lane = lane_map.lanes[lane_map.row(beside)]
        width, beside = width + lane.width, getattr(lane, side)
    return width
