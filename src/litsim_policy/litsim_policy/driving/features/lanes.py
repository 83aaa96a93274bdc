"""Features of the lane that an agent is in, for the observations of policy C and of the imitated traffic.

The features (7): left and right lane marking, left and right road edge, lane offset, curvature, heading to the lane.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from litsim_policy.driving.features.scales import CURVATURE, EDGE, HEADING, LATERAL
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.scene import FloatArray
from litsim_sim.kernels.compiled import Floats, Floats2, OutFloats2, kernel
from litsim_sim.lane_map.lane_map import LaneMap, LanePosition

ROAD = 7  # number of these features
CURVE_LENGTH = 10.0  # [m] length of lane around the agent over which its curvature is measured


class RoadWidths(NamedTuple):
    """Half the width of each lane, and the width of the road beyond it on either side [m]."""

    half_width: Floats
    to_left: Floats
    to_right: Floats


class LaneFeatures:
    """The ROAD features of agents: markings, edges, offset and heading in the lane, and its curvature."""

    def __init__(self, lane_map: LaneMap) -> None:
        self._lane_map = lane_map
        lanes = lane_map.lanes
        rows = range(len(lanes))
        self._widths = RoadWidths(
            0.5 * np.array([lane.width for lane in lanes]),
            np.array([_width_beyond(lane_map, row, "left") for row in rows]),
            np.array([_width_beyond(lane_map, row, "right") for row in rows]),
        )

    def write(self, agents: PathFollowers, first: int, features: FloatArray) -> None:
        """Write the features of `agents` into `features` (m, size), from the position `first` on."""
        position = agents.lane
        around = self._lane_map.headings_around(position.lane, position.s, 0.5 * CURVE_LENGTH)
        _write(position, around, agents.yaw, self._widths, first, features)


@kernel
def _write(
    position: LanePosition, around: Floats2, yaw: Floats, widths: RoadWidths, first: int, features: OutFloats2
) -> None:
    """Write the ROAD features of m agents with headings `yaw` into `features` (m, size), from the position `first` on.

    `around` (m, 2) are headings of the lane half of CURVE_LENGTH behind and ahead [rad].
    """
    for i in range(len(yaw)):
        lane, d, half_width = position.lane[i], position.d[i], widths.half_width[position.lane[i]]
        marker_left, marker_right = half_width - d, half_width + d
        features[i, first] = marker_left / LATERAL
        features[i, first + 1] = marker_right / LATERAL
        features[i, first + 2] = (marker_left + widths.to_left[lane]) / EDGE
        features[i, first + 3] = (marker_right + widths.to_right[lane]) / EDGE
        features[i, first + 4] = d / LATERAL
        features[i, first + 5] = wrapped(around[i, 1] - around[i, 0]) / CURVE_LENGTH / CURVATURE
        features[i, first + 6] = wrapped(yaw[i] - position.heading[i]) / HEADING


def _width_beyond(lane_map: LaneMap, row: int, side: Literal["left", "right"]) -> float:
    """Width [m] of the lanes of the same edge beyond the lane in `row`, on that side."""
    width, beside = 0.0, getattr(lane_map.lanes[row], side)
    while beside is not None:
        lane = lane_map.lanes[lane_map.row(beside)]
        width, beside = width + lane.width, getattr(lane, side)
    return width
