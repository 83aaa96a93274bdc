"""Giving way, a rule of policy `yield`: to the opponent, and to those alongside that are ahead."""

from __future__ import annotations

import math

import numpy as np

from litsim_policy.motion.car_following import idm
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import BOOLS2, FLOATS, FLOATS2, INTS, OUT_FLOATS, boolean, float64, int64, kernel


@kernel(boolean(FLOATS, FLOATS, FLOATS, INTS, int64, int64))
def _goes_first(x: FloatArray, y: FloatArray, yaw: FloatArray, ids: IntArray, j: int, own: int) -> bool:
    """Whether the agent in row `j` has priority over that in row `own` when both are alongside; never mutual.

    Where paths cross, each agent can be ahead on the other's; along the mean direction of both headings only one is.
    """
    along = (x[j] - x[own]) * (math.cos(yaw[j]) + math.cos(yaw[own]))
    along += (y[j] - y[own]) * (math.sin(yaw[j]) + math.sin(yaw[own]))
    return along > 0.0 or (along == 0.0 and ids[j] < ids[own])


@kernel(
    OUT_FLOATS(
        *(FLOATS2, FLOATS2, BOOLS2, BOOLS2, FLOATS2),
        *(INTS, INTS, FLOATS, FLOATS, FLOATS),
        *(INTS, FLOATS, FLOATS, INTS),
        *[float64] * 6,
    )
)
def give_way(  # noqa: PLR0917 - a kernel takes arrays and numbers
    gap: FloatArray,
    along: FloatArray,
    ahead: BoolArray,
    in_path: BoolArray,
    aside: FloatArray,
    first: IntArray,
    ids: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    rows: IntArray,
    speed: FloatArray,
    wanted: FloatArray,
    opponent: IntArray,
    courtesy_deceleration: float,
    headway: float,
    standstill_gap: float,
    acceleration: float,
    deceleration: float,
    braking_max: float,
) -> FloatArray:
    """Accelerations (m,) [m/s2] with which agents follow others on their paths, and give way.

    Args:
        gap, along, ahead, in_path, aside, first: (m, w), (m,) of
            :class:`litsim_policy.motion.along_path.AlongPath`; `along` is the speed there.
        ids, x, y, yaw: (n,) of all agents.
        rows, speed, wanted: (m,) of the agents: rows, speeds and the speeds that they would drive [m/s].
        opponent: (m,) ids.
        courtesy_deceleration: as in :class:`.yield_policy.YieldConfig`.
        headway, standstill_gap, acceleration, deceleration, braking_max: of the car following.
    """
    found = np.empty(len(rows))
    count = gap.shape[1]
    leads, courted = np.empty(count, np.bool_), np.empty(count, np.bool_)
    model = (headway, standstill_gap, acceleration, deceleration, braking_max)
    for i in range(len(rows)):
        courted_any, in_the_way = False, False
        for j in range(count):
            leads[j] = ahead[i, j] and in_path[i, j] and gap[i, j] > 0.0
            courted[j] = ahead[i, j] and (in_path[i, j] or ids[first[i] + j] == opponent[i]) and not leads[j]
            if courted[j] and not gap[i, j] > 0.0:
                courted[j] = _goes_first(x, y, yaw, ids, first[i] + j, rows[i])
            if courted[j]:
                courted_any = True
                in_the_way = in_the_way or (aside[i, j] < 0.0 and along[i, j] < speed[i])
        found[i] = idm(speed[i], wanted[i], gap[i], along[i], leads, *model)
        if courted_any:
            courtesy = idm(speed[i], wanted[i], gap[i], along[i], courted, *model)
            if not in_the_way:
                courtesy = max(courtesy, -courtesy_deceleration)
            found[i] = min(found[i], courtesy)
    return found
