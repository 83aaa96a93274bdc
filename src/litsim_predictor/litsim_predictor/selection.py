"""Which agents a predictor looks at, and whose forecasts are read, from the agents of one step alone."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from litsim_sim.core.nearby import around
from litsim_sim.core.scene import AgentArrays, AgentTable, BoolArray, IntArray
from litsim_sim.kernels.compiled import Bools, Floats, Ints, kernel

Egos = int | IntArray
"""Id of the ego, or ids of those of several scenes (scenes,)."""

MEETING_S = 3.0  # [s] within which agents may be taken over for each other: as far as detection looks, by default
MEETING_AHEAD = 20.0  # [m] from box to box, along the heading of the agent on its log
MEETING_ASIDE = 1.5  # [m] likewise, across it
STILL = 1e-6  # [m/s] slower is nearly not at all


class Wanted(StrEnum):
    """Which of the agents of interest a predictor forecasts.

    READ: those that the conflict stage may read, see :func:`agents_read`; ALL: all of them; EGO: the ego alone.
    """

    READ = "read"
    ALL = "all"
    EGO = "ego"


@dataclass(frozen=True)
class Scope:
    """Whom a predictor forecasts, and what of it.

    Attributes:
        roi_m: radius around agents off their log within which agents are looked at [m].
        wanted: the agents that are forecast.
        modes: greatest number of manoeuvres of each besides the most probable one.
        along_lanes: whether learned models forecast along lanes that bend.
    """

    roi_m: float
    wanted: Wanted = Wanted.READ
    modes: int = 0
    along_lanes: bool = True


def selected(table: AgentTable, ego_id: Egos, roi_m: float, wanted: Wanted) -> tuple[AgentTable, IntArray]:
    """Returns the agents of interest, and the rows among them of those to forecast; both empty if there are none.

    Of interest are agents within `roi_m` [m] of the ego or of another agent off its log, those included.
    """
    off_log = table.off_log | table.mask(np.atleast_1d(ego_id))
    near = around(table, off_log, roi_m)
    if wanted == Wanted.ALL:
        forecast = near
    elif wanted == Wanted.EGO:
        forecast = near & table.mask(np.atleast_1d(ego_id))
    else:
        forecast = near & agents_read(table, off_log)
    return table.take(near), forecast[near].nonzero()[0]


def agents_read(table: AgentTable, off_log: BoolArray) -> BoolArray:
    """Returns the mask (n,) of the agents whose forecast the conflict stage reads, or may read.

    It reads those of agents that are `off_log` (n,), the ego among them; and, as soon as it has taken an agent over,
    that agent's in the same step, to look for others in conflict with it. Which that will be is not known yet, so these
    include all that may be taken over: whose boxes come within :data:`MEETING_AHEAD` and :data:`MEETING_ASIDE` of the
    box of an agent off its log, within :data:`MEETING_S`, all at their present velocities. Others can be taken over,
    too: they have no forecast in that one step, and are off their logs from the next on.
    """
    agents, others = (~off_log).nonzero()[0], off_log.nonzero()[0]
    if not len(agents) or not len(others):
        return off_log
    cos, sin = np.cos(table.yaw), np.sin(table.yaw)
    return off_log | _meeting(table.arrays, cos, sin, agents, others)


@kernel
def _meeting(table: AgentArrays, cos: Floats, sin: Floats, agents: Ints, others: Ints) -> Bools:
    """Mask (n,) of those in the rows `agents` that come close to one in the rows `others`; see :func:`agents_read`.

    `cos` and `sin` (n,) are those of the headings.
    """
    scene, x, y, speed, length, width = table.scene, table.x, table.y, table.speed, table.length, table.width
    meets, vx, vy = np.zeros(len(x), np.bool_), speed * cos, speed * sin
    # how far an agent may be from another, together with what is as far of the other
    half = 0.5 * (MEETING_AHEAD + MEETING_ASIDE + length + width) + MEETING_S * (np.abs(speed) + STILL)
    for i in agents:
        for j in others:
            dx, dy = x[j] - x[i], y[j] - y[i]
            if scene[j] != scene[i] or dx * dx + dy * dy > (half[i] + half[j]) ** 2:
                continue
            faster_x, faster_y = vx[j] - vx[i], vy[j] - vy[i]
            # Along and across the heading of the agent, each is within reach for one span of time; do both, and the
            # time that is looked at, have one in common?
            place = (cos[i] * dx + sin[i] * dy, cos[i] * dy - sin[i] * dx)
            velocity = (cos[i] * faster_x + sin[i] * faster_y, cos[i] * faster_y - sin[i] * faster_x)
            reach = (
                MEETING_AHEAD + 0.5 * (length[i] + length[j]),
                MEETING_ASIDE + 0.5 * (width[i] + width[j]),
            )
            begin, end = 0.0, MEETING_S
            for k in range(2):
                moves = STILL if abs(velocity[k]) < STILL else velocity[k]
                first, last = (-reach[k] - place[k]) / moves, (reach[k] - place[k]) / moves
                begin, end = max(begin, min(first, last)), min(end, max(first, last))
            if begin <= end:
                meets[i] = True
                break
    return meets
