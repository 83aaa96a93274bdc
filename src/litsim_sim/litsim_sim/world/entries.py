"""Entries of agents: those whose log begins where they would collide wait, and enter when the road is free."""

from __future__ import annotations

import math

import numpy as np

from litsim_sim.core.pair_geometry import overlap
from litsim_sim.core.scene import STEP_S, AgentArrays, AgentTable, BoolArray, Controller
from litsim_sim.kernels.compiled import kernel
from litsim_sim.scenario.log import Log

# The road is free for an agent that enters if these hold; they were chosen, not fitted.
GAP = 1.0  # [m] of free road that it needs ahead and behind
DECELERATION = 2.0  # [m/s2] of comfortable braking, which it may need behind a slower agent
SIDE_ROOM = 0.3  # [m] beyond touching boxes within which an agent is in its path
LOOK_EVERY = 2.0 * STEP_S  # [s] between the instants at which it is checked against agents behind it
LOOKS = 10  # number of these instants: 2 s at constant velocity


class Entries:
    """Decides which agents enter at a step, and remembers those that wait.

    Attributes:
        waiting: step at which the log began, by the id of each agent that waits to enter.
        late: ids of the agents that have waited and then entered.
        never_entered: ids of the agents whose log ended while they waited.
    """

    def __init__(self, log: Log, guarded: bool = True) -> None:
        """Begin with no agent waiting; unless `guarded` none ever does: each enters where and when its log begins."""
        self._log, self._guarded = log, guarded
        self.waiting: dict[int, int] = {}
        self.late: set[int] = set()
        self.never_entered: set[int] = set()

    def may_follow(self, logged: AgentTable, before: AgentTable, driven: AgentTable, displaced: BoolArray) -> BoolArray:
        """Returns the mask (n,) of who may be at their `logged` poses; agents that enter and may not, wait from now on.

        Pedestrians and cyclists always may, and so may those that were there `before`. An entry must not
        collide with agents under control, `driven` one step on, nor with those `displaced` (n,): on their logs,
        but not at the time or place of the recording. With the latter it may if it would in the recording, too.
        """
        here = (before.rows(logged.id) >= 0) | logged.obstacle
        off = displaced & (driven.rows(logged.id) < 0)
        begins = self._log.first_step[self._log.ids.searchsorted(logged.id)] == logged.step
        for row in (begins & ~here).nonzero()[0]:
            if self._blocked(logged, int(row), driven) or self._blocked_by_displaced(logged, int(row), off):
                self.waiting[int(logged.id[row])] = logged.step
            else:
                here[row] = True
        return here

    def admit(self, table: AgentTable, logged: AgentTable) -> AgentTable:
        """Returns `table` with the agents that wait and can enter now, under POLICY, where their log begins.

        Agents that have left the log by now, whose agents of the step are `logged`, will never enter.
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
            table = AgentTable.merged(table.step, (table, entering))
        return table

    def _blocked(self, entry: AgentTable, row: int, others: AgentTable) -> bool:
        """Returns whether an agent's logged entry would collide with `others`."""
        speed = self._speed(entry, row, others)
        return speed is None or speed < float(entry.speed[row])

    def _blocked_by_displaced(self, logged: AgentTable, row: int, off: BoolArray) -> bool:
        """Returns the same for the agents in the mask `off` (n,), unless they would block it in the recording, too."""
        off = off & (np.arange(len(logged)) != row)
        if not off.any() or not self._blocked(logged, row, logged.take(off)):
            return False
        recorded = self._log.table(logged.step)
        return not self._blocked(logged, row, recorded.take(recorded.mask(logged.id[off])))

    def _speed(self, entry: AgentTable, row: int, others: AgentTable) -> float | None:
        """Returns the speed [m/s], at most the logged one, at which an agent can enter among `others`, or None."""
        if not self._guarded:
            return float(entry.speed[row])
        scene = int(entry.scene[row])
        begin, end = others.scene.searchsorted((scene, scene + 1)).tolist()
        speed = _entry_speed(others.arrays, begin, end, entry.arrays, row)
        return None if speed < 0.0 else speed


@kernel
def _entry_speed(others: AgentArrays, begin: int, end: int, entry: AgentArrays, row: int) -> float:
    """Returns the speed [m/s], at most its own, at which an agent can enter among others; below 0 if it cannot.

    It is in `row` of `entry`, and the others are in the rows from `begin` to `end`.
    """
    own_x, own_y, own_yaw = entry.x[row], entry.y[row], entry.yaw[row]
    own_speed, own_length, own_width = entry.speed[row], entry.length[row], entry.width[row]
    cos, sin, speed = math.cos(own_yaw), math.sin(own_yaw), own_speed
    for j in range(begin, end):
        dx, dy = others.x[j] - own_x, others.y[j] - own_y
        ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
        if ahead > 0.0 and abs(left) < 0.5 * (others.width[j] + own_width) + SIDE_ROOM:
            room = ahead - 0.5 * (others.length[j] + own_length) - GAP
            if room < 0.0:
                return -1.0
            speed = min(speed, math.sqrt(others.speed[j] ** 2 + room * 2.0 * DECELERATION))
    for j in range(begin, end):
        dx, dy = others.x[j] - own_x, others.y[j] - own_y
        ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
        follows = ahead <= 0.0 and abs(left) < 0.5 * (others.width[j] + own_width) + SIDE_ROOM
        nearing_x = others.speed[j] * math.cos(others.yaw[j]) - speed * cos
        nearing_y = others.speed[j] * math.sin(others.yaw[j]) - speed * sin
        for k in range(LOOKS if follows else 1):
            time = k * LOOK_EVERY
            then_x, then_y = dx + time * nearing_x, dy + time * nearing_y
            if overlap(
                then_x, then_y, own_yaw, others.yaw[j], own_length + GAP, own_width, others.length[j], others.width[j]
            ):
                return -1.0
    return speed
