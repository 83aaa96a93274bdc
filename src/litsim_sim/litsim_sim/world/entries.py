"""Entries of agents: those whose log begins where they would collide wait, and enter when the road is free."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.geometry import boxes_overlap, to_body
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Positive, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, Controller
from litsim_sim.scenario.log import Log

SIDE_ROOM = 0.3  # [m] beyond touching boxes within which somebody is in the path of an agent that enters


@configuration
class EntryConfig:
    """When the road is free for an agent that enters.

    Attributes:
        gap: free road that an entry needs ahead and behind.
        horizon: time over which an entry is checked at constant velocity.
        deceleration: braking that an entry may need behind a slower agent.
    """

    gap: NonNegative[Length] = 1.0
    horizon: Positive[Duration] = 2.0
    deceleration: NonNegative[Acceleration] = 2.0


class Entries:
    """Decides which agents enter at a step, and remembers those that wait.

    Attributes:
        waiting: step at which the log began, by the id of each agent that waits to enter.
        late: ids of the agents that have waited and then entered.
        never_entered: ids of the agents whose log ended while they waited.
    """

    def __init__(self, log: Log, config: EntryConfig | None) -> None:
        """Nobody waits; without `config` nobody ever will: each agent enters where and when its log begins."""
        self._log, self._config = log, config
        self.waiting: dict[int, int] = {}
        self.late: set[int] = set()
        self.never_entered: set[int] = set()

    def may_follow(
        self, logged: AgentTable, before: AgentTable, driven: AgentTable, displaced: BoolArray | None = None
    ) -> BoolArray:
        """Which agents may be where their log has them; those that enter and may not, wait from now on.

        Pedestrians and cyclists may always.

        Args:
            logged: the (n) agents of the log at the step that is made.
            before: the agents on the road one step earlier; they may follow.
            driven: the agents under control, one step on; an entry must not collide with them.
            displaced: mask (n,) of those on their logs, but not at the time or at the place of the recording: with a
                lag, or with a residual that fades. An entry must not collide with them either, unless it would where
                the recording has them, too. None is nobody.

        Returns:
            mask (n,).
        """
        here = (before.rows(logged.id) >= 0) | logged.obstacle
        off = np.zeros(len(logged), np.bool_) if displaced is None else displaced & (driven.rows(logged.id) < 0)
        begins = self._log.first_step[np.searchsorted(self._log.ids, logged.id)] == logged.step
        for row in np.flatnonzero(begins & ~here):
            if self._blocked(logged, int(row), driven) or self._blocked_by_displaced(logged, int(row), off):
                self.waiting[int(logged.id[row])] = logged.step
            else:
                here[row] = True
        return here

    def admit(self, table: AgentTable, logged: AgentTable) -> AgentTable:
        """Let agents that wait enter where their log begins, under POLICY, as soon as the road is free.

        Args:
            table: the agents of the step that is made.
            logged: the agents of the log at that step; who has gone from it will never enter.

        Returns:
            `table` with those that have entered.
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
        """Whether an agent cannot enter among `others` as it is logged."""
        speed = self._speed(entry, row, others)
        return speed is None or speed < float(entry.speed[row])

    def _blocked_by_displaced(self, logged: AgentTable, row: int, off: BoolArray) -> bool:
        """The same of those that the mask `off` (n,) has, where they would not block it in the recording."""
        off = off & (np.arange(len(logged)) != row)
        if not off.any() or not self._blocked(logged, row, logged.take(off)):
            return False
        recorded = self._log.table(logged.step)
        return not self._blocked(logged, row, recorded.take(recorded.mask(logged.id[off])))

    def _speed(self, entry: AgentTable, row: int, others: AgentTable) -> float | None:
        """Speed [m/s], at most the logged one, at which an agent can enter among `others`; None where it cannot."""
        config, log_speed = self._config, float(entry.speed[row])
        others = others.take(others.scene == entry.scene[row])
        if config is None or not len(others):
            return log_speed
        dx, dy = others.x - entry.x[row], others.y - entry.y[row]
        ahead, left = to_body(dx, dy, entry.yaw[row])
        in_path = np.abs(left) < 0.5 * (others.width + entry.width[row]) + SIDE_ROOM
        gap = ahead - 0.5 * (others.length + entry.length[row]) - config.gap
        leads = in_path & (ahead > 0)
        speed = log_speed
        if leads.any():
            room = np.maximum(gap[leads], 0.0) * 2.0 * config.deceleration
            speed = min(speed, float(np.sqrt(others.speed[leads] ** 2 + room).min()))
            if (gap[leads] < 0).any():
                return None
        times = np.arange(0.0, config.horizon, 2 * STEP_S)[:, None]
        relative_x = dx + times * (others.speed * np.cos(others.yaw) - speed * np.cos(entry.yaw[row]))
        relative_y = dy + times * (others.speed * np.sin(others.yaw) - speed * np.sin(entry.yaw[row]))
        size = (entry.length[row] + config.gap, entry.width[row])
        follows = in_path & (ahead <= 0)
        hit = boxes_overlap(relative_x, relative_y, entry.yaw[row], others.yaw, size, (others.length, others.width))
        return None if (hit & ((times == 0.0) | follows)).any() else speed
