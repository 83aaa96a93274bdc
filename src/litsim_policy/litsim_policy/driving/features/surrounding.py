"""Features of the agents around an agent: the nearest in each sector.

The features of a slot (7): present, distance of the front ends, speed, sine and cosine of the bearing, sine and cosine
of the relative heading. A slot without an agent is all zeros.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from litsim_policy.driving.features.scales import DISTANCE, SPEED
from litsim_policy.motion.along_path import PoseArrays
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.scene import AgentArrays, FloatArray
from litsim_sim.kernels.compiled import Floats, Ints, OutFloats2, kernel

SLOT = 7  # number of features of a slot


class SeenPairs(NamedTuple):
    """k pairs of an observer and an agent within its sight, ordered by the observer; arrays (k,).

    Attributes:
        observer: position of the observer among m.
        agent: row of the agent among n.
        ahead, left: distances of the agent from the observer [m].
        bearing: of the agent, relative to the observer's heading [rad].
    """

    observer: Ints
    agent: Ints
    ahead: Floats
    left: Floats
    bearing: Floats


class Slots(NamedTuple):
    """The slots, one a sector: their number, and the position of their first feature."""

    number: int
    first: int


def write_surrounding(agents: PathFollowers, sight: float, slots: int, first: int, features: FloatArray) -> None:
    """Write features of the agents within `sight` [m] of each of `agents` to `features` (m, size), from `first` on."""
    table, rows = agents.table.arrays, agents.rows
    observer, agent, ahead, left = _pairs_in_sight(table, rows, agents.own, sight)
    pairs = SeenPairs(observer, agent, ahead, left, np.arctan2(left, ahead))
    _write(pairs, table, rows, agents.yaw, Slots(slots, first), features)


@kernel
def _pairs_in_sight(
    agents: AgentArrays, rows: Ints, own: PoseArrays, sight: float
) -> tuple[Ints, Ints, Floats, Floats]:
    """Returns the fields of :class:`SeenPairs`, except the bearing, of observers in `rows` (m,) at poses `own`."""
    begin, end = within_scenes(agents.scene, rows)
    most = (end - begin).sum()
    observer, agent, ahead, left = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most), np.empty(most)
    k = 0
    for i in range(len(rows)):
        cos, sin = math.cos(own.yaw[i]), math.sin(own.yaw[i])
        for j in range(begin[i], end[i]):
            dx, dy = agents.x[j] - own.x[i], agents.y[j] - own.y[i]
            if j != rows[i] and math.hypot(dx, dy) <= sight:
                observer[k], agent[k] = i, j
                ahead[k], left[k] = dx * cos + dy * sin, dy * cos - dx * sin
                k += 1
    return observer[:k], agent[:k], ahead[:k], left[:k]


@kernel
def _write(
    pairs: SeenPairs, agents: AgentArrays, rows: Ints, own_yaw: Floats, slots: Slots, features: OutFloats2
) -> None:
    """Write the surrounding agents: the nearest per sector; of equally near ones the lower row."""
    observer, agent, ahead, left, bearing = pairs
    chosen = np.full((len(rows), slots.number), -1, np.int64)
    near = np.full((len(rows), slots.number), np.inf)
    for k in range(len(observer)):
        i, turn = observer[k], agents.yaw[agent[k]] - own_yaw[observer[k]]
        front, own_front = 0.5 * agents.length[agent[k]], 0.5 * agents.length[rows[i]]
        apart = math.hypot(ahead[k] + front * math.cos(turn) - own_front, left[k] + front * math.sin(turn))
        sector = int(np.floor(bearing[k] / (2.0 * math.pi / slots.number) + 0.5)) % slots.number
        if apart < near[i, sector]:
            chosen[i, sector], near[i, sector] = k, apart
    for i in range(len(rows)):
        for sector in range(slots.number):
            k, place = chosen[i, sector], slots.first + SLOT * sector
            if k < 0:
                continue
            turn = agents.yaw[agent[k]] - own_yaw[i]
            features[i, place] = 1.0
            features[i, place + 1] = near[i, sector] / DISTANCE
            features[i, place + 2] = agents.speed[agent[k]] / SPEED
            features[i, place + 3], features[i, place + 4] = math.sin(bearing[k]), math.cos(bearing[k])
            features[i, place + 5], features[i, place + 6] = math.sin(turn), math.cos(turn)
