"""Outcome of commands over the next seconds: future poses, and time of the first contact.

Agents keep the commanded acceleration, and their turns end with a time constant; all others drive straight on, and keep
braking if they brake.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Annotated

import numpy as np
import numpy.typing as npt

from litsim_sim.core.nearby import Sorted, sorted_by_place, within_reach
from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import STEP_S, AgentArrays, AgentTable, FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, Floats2, Floats3, Ints, float64, kernel, read_array

Floats4 = Annotated[npt.NDArray[np.float64], read_array(float64, 4)]
SETTLE = 0.5  # [s] time constant with which turns are expected to end
ROUNDING = 1e-9  # [m] by which the circles around two boxes are widened


def steps_of(seconds: float) -> int:
    """Number of steps of a look-ahead over `seconds`, at least one."""
    return max(1, round(seconds / STEP_S))


def rolled_out(table: AgentTable, rows: IntArray, commands: FloatArray, instants: int) -> FloatArray:
    """Returns future poses (3, m, c, T), x, y [m], yaw [rad], of agents in `rows` (m,) at T = `instants` of 0.1 s.

    The `commands` (m, c, 2) are accelerations [m/s2] and yaw rates [rad/s], c for each agent.
    """
    return _rolled_out(table.arrays, rows, commands, _turned(instants))


@cache
def _turned(instants: int) -> FloatArray:
    """Share (instants,) of a turn that is completed at each instant."""
    return np.asarray(1.0 - np.exp(-STEP_S * np.arange(1, instants + 1, dtype=np.float64) / SETTLE))


def first_touch(table: AgentTable, rows: IntArray, poses: FloatArray, margin: float) -> FloatArray:
    """Returns times (m, c) [s] at which agents at `poses` of :func:`rolled_out` first touch another; inf for none.

    Existing contacts and followers do not count. A `margin` [m] is kept around other boxes, except around those
    that are already nearer than that.
    """
    return _first_touch(sorted_by_place(table, rows), table.arrays, rows, poses, margin)


@kernel
def _rolled_out(agents: AgentArrays, rows: Ints, commands: Floats3, turned: Floats) -> Floats4:
    """See :func:`rolled_out`; `turned` (T,) is the share of a turn that is completed at each instant."""
    count, instants = commands.shape[1], len(turned)
    poses = np.empty((3, len(rows), count, instants))
    for i in range(len(rows)):
        own = rows[i]
        for c in range(count):
            along_x, along_y = 0.0, 0.0
            for k in range(instants):
                now = max(agents.speed[own] + commands[i, c, 0] * (STEP_S * (k + 1)), 0.0)
                heading = agents.yaw[own] + commands[i, c, 1] * SETTLE * turned[k]
                along_x += now * math.cos(heading)
                along_y += now * math.sin(heading)
                poses[0, i, c, k] = agents.x[own] + STEP_S * along_x
                poses[1, i, c, k] = agents.y[own] + STEP_S * along_y
                poses[2, i, c, k] = heading
    return poses


@kernel
def _first_touch(by_place: Sorted, agents: AgentArrays, rows: Ints, poses: Floats4, margin: float) -> Floats2:
    """See :func:`first_touch`; `by_place` are the agents sorted for those in `rows`."""
    x, y, yaw, speed = agents.x, agents.y, agents.yaw, agents.speed
    length, width = agents.length, agents.width
    commands, instants = poses.shape[2], poses.shape[3]
    touch, horizon = np.full((len(rows), commands), np.inf), STEP_S * instants
    farthest = 0.0  # that others come
    for j in range(len(x)):
        farthest = max(farthest, length[j] + speed[j] * horizon)
    for i in range(len(rows)):
        own = rows[i]
        cos, sin = math.cos(yaw[own]), math.sin(yaw[own])
        begin, end = within_reach(by_place, i, own, length[own] + speed[own] * horizon + farthest + ROUNDING)
        for place in range(begin, end):
            j = by_place.order[place]
            dx, dy = x[j] - x[own], y[j] - y[own]
            reach = length[j] + length[own] + (speed[j] + speed[own]) * horizon
            if j == own or not dx * dx + dy * dy < reach * reach:
                continue
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            follows = ahead < -0.5 * (length[j] + length[own]) and abs(left) < 0.5 * (width[j] + width[own])
            long, wide = length[j] + 2.0 * margin, width[j] + 2.0 * margin
            if overlap(dx, dy, yaw[own], yaw[j], length[own], width[own], long, wide):
                long, wide = length[j], width[j]
            if follows or overlap(dx, dy, yaw[own], yaw[j], length[own], width[own], long, wide):
                continue
            radius = 0.5 * (math.hypot(long, wide) + math.hypot(length[own], width[own])) + ROUNDING
            braking = min(agents.acceleration[j], 0.0)
            stops = -speed[j] / min(braking, -1e-3) if braking < 0.0 else np.inf
            other_cos, other_sin = math.cos(yaw[j]), math.sin(yaw[j])
            for k in range(instants):
                instant = STEP_S * (k + 1)
                time = min(instant, stops)
                gone = speed[j] * time + 0.5 * braking * time**2
                other_x, other_y = x[j] + gone * other_cos, y[j] + gone * other_sin
                for c in range(commands):
                    if instant >= touch[i, c]:
                        continue
                    dx, dy = other_x - poses[0, i, c, k], other_y - poses[1, i, c, k]
                    if dx * dx + dy * dy < radius**2 and overlap(
                        dx, dy, poses[2, i, c, k], yaw[j], length[own], width[own], long, wide
                    ):
                        touch[i, c] = instant
    return touch
