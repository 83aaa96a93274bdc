"""Entries of agents: those whose log begins where they would collide wait, and enter when the road is free."""

from __future__ import annotations

import math

import numpy as np
from numba.types import UniTuple

from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import AGENTS, STEP_S, AgentArrays, AgentTable, BoolArray, Controller
from litsim_sim.kernels.compiled import float64, int64, kernel
from litsim_sim.scenario.log import Log

SIDE_ROOM = 0.3  # [m] beyond touching boxes within which an agent is in the path of one that enters
GAP = 1.0  # [m] free road that an entry needs ahead and behind
HORIZON = 2.0  # [s] over which an entry is checked at constant velocity
DECELERATION = 2.0  # [m/s2] braking that an entry may need behind a slower agent
LOOK_EVERY = 2.0 * STEP_S  # [s] between the times at which an entry is checked


class Entries:
    """Decides which agents enter at a step, and remembers those that wait.

    Attributes:
        waiting: step at which the log began, by the id of each agent that waits to enter.
        late: ids of the agents that have waited and then entered.
        never_entered: ids of the agents whose log ended while they waited.
    """

    def __init__(self, log: Log, *, guarded: bool = True) -> None:
        """Begin with no agent waiting; unless `guarded` none ever does: each enters where and when its log begins."""
        self._log, self._guarded = log, guarded
        self.waiting: dict[int, int] = {}
        self.late: set[int] = set()
        self.never_entered: set[int] = set()

    def may_follow(
        self, logged: AgentTable, before: AgentTable, driven: AgentTable, displaced: BoolArray | None = None
    ) -> BoolArray:
        """Mask of the agents that may be at their logged poses; those that enter and may not, wait from now on.

        Pedestrians and cyclists always may.

        Args:
            logged: the (n) agents of the log at the step that is made.
            before: the agents on the road one step earlier; they may follow.
            driven: the agents under control, one step on; an entry must not collide with them.
            displaced: mask (n,) of those on their logs, but not at the time or at the place of the recording: with a
                lag, or with a residual that fades. An entry must not collide with them either, unless it would in the
                recording, too. None means no agents.

        Returns:
            Mask (n,).
        """
        here = (before.rows(logged.id) >= 0) | logged.obstacle
        off = np.zeros(len(logged), np.bool_) if displaced is None else displaced & (driven.rows(logged.id) < 0)
        begins = self._log.first_step[self._log.ids.searchsorted(logged.id)] == logged.step
        for row in (begins & ~here).nonzero()[0]:
            if self._blocked(logged, int(row), driven) or self._blocked_by_displaced(logged, int(row), off):
                self.waiting[int(logged.id[row])] = logged.step
            else:
                here[row] = True
        return here

    def admit(self, table: AgentTable, logged: AgentTable) -> AgentTable:
        """Let agents that wait enter where their log begins, under POLICY, as soon as the road is free.

        Args:
            table: the agents of the step that is made.
            logged: the agents of the log at that step; agents that have left it will never enter.

        Returns:
            `table` with the agents that have entered.
        """
        for agent, began in sorted(self.waiting.items()):
            if logged.row(agent) < 0:
                del self.waiting[agent]
                self.never_entered.add(agent)
                continue
            entry = self._log.table(began)
            row = entry.row(agent)
            speed = self._speed(entry, row, table)
            if began == table.step or speed is None:
                continue
            entering = entry.take(np.array([row]))
            entering.speed[0] = min(speed, entering.speed[0])
            entering.acceleration[0] = entering.yaw_rate[0] = 0.0
            entering.controller[0] = Controller.POLICY
            del self.waiting[agent]
            self.late.add(agent)
            table = type(table).merged(table.step, (table, entering))
        return table

    def _blocked(self, entry: AgentTable, row: int, others: AgentTable) -> bool:
        """Whether an agent's logged entry would collide with `others`."""
        speed = self._speed(entry, row, others)
        return speed is None or speed < float(entry.speed[row])

    def _blocked_by_displaced(self, logged: AgentTable, row: int, off: BoolArray) -> bool:
        """The same for the agents of the mask `off` (n,), except those that would block it in the recording, too."""
        off = off & (np.arange(len(logged)) != row)
        if not off.any() or not self._blocked(logged, row, logged.take(off)):
            return False
        recorded = self._log.table(logged.step)
        return not self._blocked(logged, row, recorded.take(recorded.mask(logged.id[off])))

    def _speed(self, entry: AgentTable, row: int, others: AgentTable) -> float | None:
        """Speed [m/s], at most the logged one, at which an agent can enter among `others`; None if it cannot."""
        if not self._guarded:
            return float(entry.speed[row])
        scene = int(entry.scene[row])
        begin, end = others.scene.searchsorted((scene, scene + 1)).tolist()
        speed = _entry_speed(others.arrays, begin, end, entry.arrays, row)
        return None if speed < 0.0 else speed


@kernel(UniTuple(float64, 2)(*[float64] * 6))
def _from(x: float, y: float, cos: float, sin: float, other_x: float, other_y: float) -> tuple[float, float]:
    """Distance [m] of one place ahead of another and to its left, with `cos` and `sin` of the heading at the latter."""
    dx, dy = other_x - x, other_y - y
    return dx * cos + dy * sin, dy * cos - dx * sin


@kernel(float64(AGENTS, int64, int64, AGENTS, int64))
def _entry_speed(others: AgentArrays, begin: int, end: int, entry: AgentArrays, row: int) -> float:
    """Speed [m/s], at most its own, at which an agent can enter among others; below 0 if it cannot.

    Args:
        others: all agents.
        begin, end: row of the first of the others, and row after the last.
        entry, row: agents as they are logged, and the row of this one.
    """
    own_x, own_y, own_yaw = entry.x[row], entry.y[row], entry.yaw[row]
    own_speed, own_length, own_width = entry.speed[row], entry.length[row], entry.width[row]
    cos, sin, found = math.cos(own_yaw), math.sin(own_yaw), own_speed
    for j in range(begin, end):
        ahead, left = _from(own_x, own_y, cos, sin, others.x[j], others.y[j])
        if ahead > 0.0 and abs(left) < 0.5 * (others.width[j] + own_width) + SIDE_ROOM:
            room = ahead - 0.5 * (others.length[j] + own_length) - GAP
            if room < 0.0:
                return -1.0
            found = min(found, math.sqrt(others.speed[j] ** 2 + room * 2.0 * DECELERATION))
    instants = math.ceil(HORIZON / LOOK_EVERY)
    for j in range(begin, end):
        ahead, left = _from(own_x, own_y, cos, sin, others.x[j], others.y[j])
        follows = ahead <= 0.0 and abs(left) < 0.5 * (others.width[j] + own_width) + SIDE_ROOM
        nearing_x = others.speed[j] * math.cos(others.yaw[j]) - found * cos
        nearing_y = others.speed[j] * math.sin(others.yaw[j]) - found * sin
        for k in range(instants if follows else 1):
            time = k * LOOK_EVERY
            dx, dy = others.x[j] - own_x + time * nearing_x, others.y[j] - own_y + time * nearing_y
            if overlap(dx, dy, own_yaw, others.yaw[j], own_length + GAP, own_width, others.length[j], others.width[j]):
                return -1.0
    return found
