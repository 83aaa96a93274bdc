"""Whom a predictor looks at, and whose forecast somebody reads: functions of one step's agents and of nothing else."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray

MEETING_S = 3.0  # [s] within which agents may be taken over for each other: as far as detection looks, by default
MEETING_AHEAD = 20.0  # [m] from box to box, along the heading of the agent on its log
MEETING_ASIDE = 1.5  # [m] likewise, across it
STILL = 1e-6  # [m/s] slower is nearly not at all


class Wanted(StrEnum):
    """Whom a predictor forecasts, of the agents of interest.

    READ: those that the conflict stage may read, see :func:`agents_read`; ALL: all of them; EGO: the ego alone.
    """

    READ = "read"
    ALL = "all"
    EGO = "ego"


def agents_of_interest(table: AgentTable, ego_id: int, roi_m: float) -> BoolArray:
    """(n,) agents within `roi_m` metres of the ego or of another agent off its log, those included."""
    centre = _off_log(table, ego_id)
    dx = table.x[:, None] - table.x[centre][None, :]
    dy = table.y[:, None] - table.y[centre][None, :]
    return centre | (dx**2 + dy**2 <= roi_m**2).any(axis=1)


def agents_read(table: AgentTable, ego_id: int) -> BoolArray:
    """(n,) agents whose forecast the conflict stage reads, or may read.

    It reads that of the ego and of whoever is off its log; and, as soon as it has taken somebody over, his in the same
    step, to look for those whom he is in the way of. Who that will be is not known yet; so those are among these who
    may be taken over: whose boxes come within :data:`MEETING_AHEAD` and :data:`MEETING_ASIDE` of the box of somebody
    off his log, within :data:`MEETING_S`, everybody at the velocity of now. It is not certain that nobody else is
    taken over: such a one has no forecast in that one step, and from the next on he is off his log.
    """
    off = _off_log(table, ego_id)
    return off | _may_meet(table, np.flatnonzero(~off), np.flatnonzero(off))


def selected(table: AgentTable, ego_id: int, roi_m: float, wanted: Wanted) -> tuple[AgentTable, IntArray]:
    """The agents of interest, and the rows among them of those to forecast; nobody at all where there are none."""
    seen = agents_of_interest(table, ego_id, roi_m)
    if wanted == Wanted.ALL:
        forecast = seen
    elif wanted == Wanted.EGO:
        forecast = seen & (table.id == ego_id)
    else:
        forecast = seen & agents_read(table, ego_id)
    return table.take(seen), np.flatnonzero(forecast[seen])


def _off_log(table: AgentTable, ego_id: int) -> BoolArray:
    return table.off_log | (table.id == ego_id)


def _may_meet(table: AgentTable, agents: IntArray, others: IntArray) -> BoolArray:
    """(n,) those in the rows `agents` who come close to one in the rows `others`."""
    found = np.zeros(len(table), np.bool_)
    if not len(agents) or not len(others):
        return found
    cos, sin = np.cos(table.yaw), np.sin(table.yaw)
    a = agents[:, None]

    def apart(values: FloatArray) -> FloatArray:
        return values[others] - values[a]

    def turned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Along and across the heading of the agent."""
        return cos[a] * x + sin[a] * y, cos[a] * y - sin[a] * x

    place = turned(apart(table.x), apart(table.y))
    velocity = turned(apart(table.speed * cos), apart(table.speed * sin))
    reach = [
        MEETING_AHEAD + 0.5 * (table.length[a] + table.length[others]),
        MEETING_ASIDE + 0.5 * (table.width[a] + table.width[others]),
    ]
    # Each direction is within reach for one span of time; do both and the time that is looked at have one in common?
    begin, end = np.zeros(place[0].shape), np.full(place[0].shape, MEETING_S)
    for at, moving, within in zip(place, velocity, reach, strict=True):
        moves = np.where(np.abs(moving) < STILL, STILL, moving)
        first, last = (-within - at) / moves, (within - at) / moves
        begin, end = np.maximum(begin, np.minimum(first, last)), np.minimum(end, np.maximum(first, last))
    found[agents] = (begin <= end).any(axis=1)
    return found
