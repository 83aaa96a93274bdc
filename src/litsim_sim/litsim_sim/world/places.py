"""Where agents are, seen from egos: the places in which what an agent does concerns an ego."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import BoolArray, FloatArray

AHEAD_M = 80.0  # [m] ahead of the ego within which agents act
BESIDE = (1.8, 5.5)  # [m] to the side of the ego, where agents can cut in
SAME_LANE = 1.8  # [m] to the side of the ego up to which an agent is in its lane
SAME_WAY = 0.7  # cosine of the angle between headings from which on both drive the same way
SLOWEST_MPS = 1.0  # [m/s] of the ego, for headways


class Places(NamedTuple):
    """Places of agents; arrays of one shape.

    Attributes:
        ahead, left: displacement from the ego, in its frame [m].
        in_front: whether the agent is up to AHEAD_M ahead, anywhere to the side.
        leading: whether it is ahead in the ego's lane, and drives the same way.
        beside: whether it is ahead in the lane beside, and drives the same way.
    """

    ahead: FloatArray
    left: FloatArray
    in_front: BoolArray
    leading: BoolArray
    beside: BoolArray


def places(dx: FloatArray, dy: FloatArray, yaw: FloatArray | np.float64, ego_yaw: FloatArray) -> Places:
    """Returns places of agents with headings `yaw` [rad], displaced by `dx`, `dy` [m] from egos with `ego_yaw`."""
    ahead, left = to_body(dx, dy, ego_yaw)
    in_front, aside = (ahead > 0.0) & (ahead < AHEAD_M), np.abs(left)
    along = in_front & (np.cos(yaw - ego_yaw) > SAME_WAY)
    beside = (aside > BESIDE[0]) & (aside < BESIDE[1])
    return Places(ahead, left, in_front, along & (aside < SAME_LANE), along & beside)


def headways(
    ahead: FloatArray, length: FloatArray | np.float64, ego_length: FloatArray, ego_speed: FloatArray
) -> FloatArray:
    """Returns the time [s] in which egos go the way between the bumpers to agents whose centres are `ahead` [m].

    Boxes that overlap along the way have 0; an ego that hardly moves counts as SLOWEST_MPS fast.
    """
    room = np.maximum(ahead - 0.5 * (length + ego_length), 0.0)
    return np.asarray(room / np.maximum(ego_speed, SLOWEST_MPS), np.float64)
