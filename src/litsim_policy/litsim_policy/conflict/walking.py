"""How walkers and cyclists react: where an agent off its log stands in their way, or will, they stop before it.

They rely on vehicles to brake for them, as these do (:mod:`litsim_policy.driving.yielding_rules`): a vehicle blocks
their way only if it would be there even if it braked by BRAKES. So nobody waits for a vehicle that waits for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.likelihood import as_recorded
from litsim_policy.motion.arcs import arc_of
from litsim_sim.core.pair_geometry import overlap, within_scenes
from litsim_sim.core.scene import STEP_S, AgentArrays, AgentTable, BoolArray, FloatArray, IntArray, Kind
from litsim_sim.core.takeover import TakeoverReason
from litsim_sim.kernels.compiled import Bools, Floats, Floats2, Ints, kernel
from litsim_sim.scenario.log import Log

HORIZON = 2.0  # [s] for which they look ahead: what a cyclist at 8 m/s needs to brake moderately. Untuned
BRAKES = 3.0  # [m/s2] by which vehicles brake for them: the courtesy deceleration of the rules
GAPS = {Kind.PEDESTRIAN: 0.25, Kind.BICYCLE: 0.5}  # [m] ahead, at which they stop; SUMO's defaults (vType, minGap)
SIDE_GAP = 0.1  # [m] to the side: people pass close to what stands. Untuned
_PEDESTRIAN, _INSTANTS = int(Kind.PEDESTRIAN), round(HORIZON / STEP_S)
_GAP_WALKING, _GAP_CYCLING = GAPS[Kind.PEDESTRIAN], GAPS[Kind.BICYCLE]


@dataclass(frozen=True)
class WaysAhead:
    """The ways of m walkers and cyclists by their logs over the next seconds; arrays (m,).

    Attributes:
        rows: of these agents in the table of the step.
        room: distance that is free [m]; inf where nobody is in the way.
        time: until the contact [s]; inf where nobody is in the way.
        blocker: row of who is in the way; -1 for nobody.
    """

    rows: IntArray
    room: FloatArray
    time: FloatArray
    blocker: IntArray

    @classmethod
    def of(cls, log: Log, table: AgentTable, rows: IntArray, lag: IntArray) -> WaysAhead:
        """Returns the ways of the agents in `rows` (m,) of `table`, whose logs lag by `lag` (m,) steps.

        Vehicles that are where they were recorded are in nobody's way: what happened, happened.
        """
        if not len(rows):
            return cls(rows, np.zeros(0), np.zeros(0), rows)
        others = ~table.obstacle & ~as_recorded(log, table)
        log_rows = log.ids.searchsorted(table.id[rows])
        now = np.clip(table.step - lag, log.first_step[log_rows], log.last_step[log_rows])
        logs = Logs(log.x, log.y, log.yaw, log_rows, now, log.last_step[log_rows])
        return cls(rows, *_ways_ahead(logs, table.arrays, rows, others))

    def blocked(self, count: int) -> BoolArray:
        """Returns the mask (n,) of agents with somebody in their way, n being the `count` of all agents."""
        mask = np.zeros(count, np.bool_)
        mask[self.rows[self.blocker >= 0]] = True
        return mask

    def conflicts(self, table: AgentTable, which: BoolArray) -> list[Conflict]:
        """Returns conflicts of the agents in the mask `which` (n,) of `table` with those in their way."""
        conflicts = []
        for k in (which[self.rows] & (self.blocker >= 0)).nonzero()[0].tolist():
            row = int(self.rows[k])
            ahead = self.room[k] * np.array([np.cos(table.yaw[row]), np.sin(table.yaw[row])])
            pose = np.array([table.x[row] + ahead[0], table.y[row] + ahead[1], table.yaw[row]])
            agent, opponent = int(table.id[row]), int(table.id[self.blocker[k]])
            reason = TakeoverReason.UNLIKELY
            conflicts.append(Conflict(agent, opponent, float(self.time[k]), pose, 0.0, urgent=True, reason=reason))
        return conflicts


class Logs(NamedTuple):
    """Where m agents are in their logs.

    Attributes:
        x, y, yaw: (N, S) of all logs [m], [rad].
        row, now, last: (m,) of each agent: its row there, its present step, lag included, and its last step.
    """

    x: Floats2
    y: Floats2
    yaw: Floats2
    row: Ints
    now: Ints
    last: Ints


class Pair(NamedTuple):
    """A walker or cyclist in row `own`, `length` and `width` [m] of its box with gaps, and a vehicle in row `other`."""

    own: int
    other: int
    length: float
    width: float


@kernel
def _pair(agents: AgentArrays, own: int, j: int) -> Pair:
    """Returns agents `own` and `j`; there are no gaps around `own` if `j` is nearer than these."""
    gap = _GAP_WALKING if agents.kind[own] == _PEDESTRIAN else _GAP_CYCLING
    length, width = agents.length[own] + 2.0 * gap, agents.width[own] + 2.0 * SIDE_GAP
    dx, dy, yaw = agents.x[j] - agents.x[own], agents.y[j] - agents.y[own], agents.yaw[own]
    if overlap(dx, dy, yaw, agents.yaw[j], length, width, agents.length[j], agents.width[j]):
        return Pair(own, j, agents.length[own], agents.width[own])
    return Pair(own, j, length, width)


@kernel
def _touches(logs: Logs, i: int, step: int, agents: AgentArrays, pair: Pair, place: Floats) -> bool:
    """Returns whether agent `own`, where log `i` is at `step`, touches `other` at `place` (3,) x, y [m], yaw [rad]."""
    own, length, width = pair.own, pair.length, pair.width
    other_length, other_width = agents.length[pair.other], agents.width[pair.other]
    row, now, then = logs.row[i], logs.now[i], min(step, logs.last[i])
    dx = place[0] - logs.x[row, then] - (agents.x[own] - logs.x[row, now])
    dy = place[1] - logs.y[row, then] - (agents.y[own] - logs.y[row, now])
    radius = 0.5 * (math.hypot(length, width) + math.hypot(other_length, other_width))
    return dx * dx + dy * dy < radius * radius and overlap(
        dx, dy, logs.yaw[row, then], place[2], length, width, other_length, other_width
    )


@kernel
def _first_touch(logs: Logs, i: int, agents: AgentArrays, pair: Pair, arc: Floats2) -> int:
    """Returns the instant at which agent `own`, by log `i`, first touches `other` on its `arc`; -1 for never."""
    for k in range(len(arc)):
        if _touches(logs, i, logs.now[i] + k + 1, agents, pair, arc[k]):
            return k
    return -1


@kernel
def _steps_before(logs: Logs, i: int, agents: AgentArrays, pair: Pair, arc: Floats2) -> int:
    """Returns the steps that agent `own` can go, by log `i`, without being where the `arc` of `other` ever leads.

    It is -1 for one that is there already, and is safest if it goes on.
    """
    for k in range(_INSTANTS + 1):
        for place in arc:
            if _touches(logs, i, logs.now[i] + k, agents, pair, place):
                return k - 1
    return _INSTANTS


@kernel
def _ways_ahead(logs: Logs, agents: AgentArrays, rows: Ints, others: Bools) -> tuple[Floats, Floats, Ints]:
    """Returns room (m,) [m], time (m,) [s] and blocker (m,) as in :class:`WaysAhead`; `others` is a mask (n,)."""
    room, time = np.full(len(rows), np.inf), np.full(len(rows), np.inf)
    blocker, (begin, end) = np.full(len(rows), -1, np.int64), within_scenes(agents.scene, rows)
    for i in range(len(rows)):
        row, now, own = logs.row[i], logs.now[i], rows[i]
        for j in range(begin[i], end[i]):
            if not others[j]:
                continue
            pair, arc = _pair(agents, own, j), arc_of(agents, j, agents.acceleration[j], _INSTANTS)
            touch = _first_touch(logs, i, agents, pair, arc)
            if touch < 0:
                continue
            braked = arc_of(agents, j, min(agents.acceleration[j], -BRAKES), _INSTANTS)
            if _first_touch(logs, i, agents, pair, braked) < 0:
                continue
            steps = _steps_before(logs, i, agents, pair, arc)
            free = min(now + steps, logs.last[i])
            way = math.hypot(logs.x[row, free] - logs.x[row, now], logs.y[row, free] - logs.y[row, now])
            if steps >= 0 and way < room[i]:
                room[i], time[i], blocker[i] = way, STEP_S * (touch + 1), j
    return room, time, blocker
