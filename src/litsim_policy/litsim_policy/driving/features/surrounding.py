"""Features of the agents around an agent: the nearest of all, or the nearest in each sector.

The features of a slot (7): present, distance of the front ends, speed, sine and cosine of the bearing, sine and cosine
of the relative heading. A slot without an agent is all zeros.
"""

from __future__ import annotations

import math

import numpy as np
from numba.types import Tuple

from litsim_policy.driving.features.scales import DISTANCE, SPEED
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    FLOATS,
    INTS,
    OUT_FLOATS,
    OUT_FLOATS2,
    OUT_INTS,
    boolean,
    float64,
    int64,
    kernel,
    void,
)

SLOT = 7  # number of features of a slot


def write_surrounding(
    agents: PathFollowers, sight: float, slots: int, first: int, features: FloatArray, *, by_sector: bool
) -> None:
    """Write the features of the agents within `sight` [m] of each of `agents` into `features` (m, size).

    Args:
        agents: the m observers.
        sight: range beyond which agents are ignored [m].
        slots: number of slots.
        first: position of the first feature.
        features: written to.
        by_sector: whether each slot is a sector; otherwise slots hold the nearest agents, nearest first.
    """
    table = agents.table
    observer, agent, ahead, left = _pairs_in_sight(
        table.scene, table.x, table.y, agents.rows, agents.x, agents.y, agents.yaw, sight
    )
    bearing, others = np.arctan2(left, ahead), (table.yaw, table.speed, table.length)
    _write(observer, agent, ahead, left, bearing, agents.rows, agents.yaw, *others, by_sector, slots, first, features)


@kernel(
    Tuple((OUT_INTS, OUT_INTS, OUT_FLOATS, OUT_FLOATS))(INTS, FLOATS, FLOATS, INTS, FLOATS, FLOATS, FLOATS, float64)
)
def _pairs_in_sight(
    scene: IntArray,
    x: FloatArray,
    y: FloatArray,
    rows: IntArray,
    own_x: FloatArray,
    own_y: FloatArray,
    own_yaw: FloatArray,
    sight: float,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Pairs of observing agents and agents within their sight.

    Args:
        scene: (n,) scene of each agent; only agents of one scene form pairs.
        x, y: (n,) of all agents [m].
        rows: (m,) of the observers.
        own_x, own_y, own_yaw: (m,) poses of the observers [m], [rad].
        sight: range of sight [m].

    Returns:
        k pairs, ordered by the observer: position of the observer in `rows` and row of the other agent, both (k,), and
        the distances of the latter ahead and to the left (k,) [m].
    """
    begin, end = within_scenes(scene, rows)
    most = (end - begin).sum()
    observer, agent, ahead, left = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most), np.empty(most)
    k = 0
    for i in range(len(rows)):
        cos, sin = math.cos(own_yaw[i]), math.sin(own_yaw[i])
        for j in range(begin[i], end[i]):
            dx, dy = x[j] - own_x[i], y[j] - own_y[i]
            if j != rows[i] and math.hypot(dx, dy) <= sight:
                observer[k], agent[k] = i, j
                ahead[k], left[k] = dx * cos + dy * sin, dy * cos - dx * sin
                k += 1
    return observer[:k], agent[:k], ahead[:k], left[:k]


@kernel(
    void(INTS, INTS, FLOATS, FLOATS, FLOATS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, boolean, int64, int64, OUT_FLOATS2)
)
def _write(  # noqa: PLR0917 - a kernel takes arrays and numbers
    observer: IntArray,
    agent: IntArray,
    ahead: FloatArray,
    left: FloatArray,
    bearing: FloatArray,
    rows: IntArray,
    own_yaw: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    by_sector: bool,
    slots: int,
    first: int,
    features: FloatArray,
) -> None:
    """Write the surrounding agents: the nearest per sector, or the nearest of all; of equally near ones the lower row.

    Args:
        observer, agent, ahead, left: k pairs from :func:`_pairs_in_sight`.
        bearing: (k,) of the agents relative to the observers' headings [rad].
        rows, own_yaw: (m,) of the observers, and their headings [rad].
        yaw, speed, length: (n,) of all agents [rad], [m/s], [m].
        by_sector: whether each slot is a sector.
        slots: number of slots.
        first: position of the first feature.
        features: (m, size) written to.
    """
    chosen = np.full((len(rows), slots), -1, np.int64)
    near = np.full((len(rows), slots), np.inf)
    for k in range(len(observer)):
        i, turn = observer[k], yaw[agent[k]] - own_yaw[observer[k]]
        front, own_front = 0.5 * length[agent[k]], 0.5 * length[rows[i]]
        apart = math.hypot(ahead[k] + front * math.cos(turn) - own_front, left[k] + front * math.sin(turn))
        if by_sector:
            at = int(np.floor(bearing[k] / (2.0 * math.pi / slots) + 0.5)) % slots
            if apart < near[i, at]:
                chosen[i, at], near[i, at] = k, apart
            continue
        at = slots
        while at > 0 and apart < near[i, at - 1]:
            at -= 1
        for later in range(slots - 1, at, -1):
            chosen[i, later], near[i, later] = chosen[i, later - 1], near[i, later - 1]
        if at < slots:
            chosen[i, at], near[i, at] = k, apart
    for i in range(len(rows)):
        for at in range(slots):
            k, place = chosen[i, at], first + SLOT * at
            if k < 0:
                continue
            turn = yaw[agent[k]] - own_yaw[i]
            features[i, place] = 1.0
            features[i, place + 1] = near[i, at] / DISTANCE
            features[i, place + 2] = speed[agent[k]] / SPEED
            features[i, place + 3], features[i, place + 4] = math.sin(bearing[k]), math.cos(bearing[k])
            features[i, place + 5], features[i, place + 6] = math.sin(turn), math.cos(turn)
