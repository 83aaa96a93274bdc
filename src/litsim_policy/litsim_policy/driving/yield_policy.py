"""The rule-based policy: an agent in conflict yields along its reference path, and catches up once it is free."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from litsim_policy.driving.handback import HandbackConfig, catch_up
from litsim_policy.motion.car_following import AlongPath, IdmConfig, along_path, idm_acceleration
from litsim_policy.motion.reference_path import ReferencePath, pursuit_reach, pursuit_yaw_rate
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, ControlSource, ControlTable
from litsim_sim.core.takeover import Takeover, TakeoverState, TakeoverTable
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

SOURCES = {
    TakeoverState.HELD: ControlSource.POLICY,
    TakeoverState.HANDBACK: ControlSource.HANDBACK,
    TakeoverState.RELEASED: ControlSource.LATE,
}


@dataclass(frozen=True)
class YieldConfig:
    """Parameters of :class:`YieldPolicy`.

    Attributes:
        idm: car following behind whatever is on the path.
        courtesy_deceleration: hardest braking [m/s2] for an opponent that is ahead but not yet on the path, or
            alongside without being in the way.
        speed_reserve: faster than the agent's own log by this much at most [m/s] while it is held.
        speed_min: [m/s] that an agent may always drive on a free path, though it stood there in the log.
        side_gap: free road [m] behind and ahead that a move to the side needs.
        side_horizon: [s] for which whoever approaches is expected to go on doing so.
        side_margin: [m] to the side that are kept to others.
        side_drift: [m] to the side that count as no move.
    """

    idm: IdmConfig = field(
        default_factory=lambda: IdmConfig(headway=0.8, standstill_gap=1.5, acceleration=2.0, deceleration=2.5)
    )
    courtesy_deceleration: float = 3.0
    speed_reserve: float = 1.0
    speed_min: float = 3.0
    side_gap: float = 1.0
    side_horizon: float = 1.5
    side_margin: float = 0.3
    side_drift: float = 0.05


class YieldPolicy:
    """The policy called `yield`."""

    def __init__(self, scenario: Scenario, config: YieldConfig, handback: HandbackConfig) -> None:
        self._log: Log = scenario.log
        self._lane_map = scenario.lane_map
        self._config = config
        self._handback = handback

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Controls of every agent that is held or handed back, and who is released to a log that is late."""
        listed = [t for t in takeovers.takeovers if t.state != TakeoverState.RELEASED or t.time_shift > 0.0]
        if not listed:
            return ControlTable.empty(table.step)
        rows = table.rows(np.array([t.agent for t in listed], np.int64))
        acceleration, yaw_rate = np.zeros(len(listed)), np.zeros(len(listed))
        for k, (takeover, row) in enumerate(zip(listed, rows.tolist(), strict=True)):
            if takeover.state == TakeoverState.RELEASED:
                continue
            path = ReferencePath.of(takeover.reference_path)
            view = along_path(path, table, row)
            if takeover.state == TakeoverState.HELD:
                acceleration[k] = self._hold(table, row, takeover, path, view)
            else:
                acceleration[k] = self._hand_back(table, row, takeover, path, view)
            yaw_rate[k] = self._steer(table, row, path)
        return ControlTable(
            table.step,
            table.id[rows],
            acceleration,
            table.speed[rows] * yaw_rate,
            yaw_rate,
            np.array([SOURCES[t.state] for t in listed], np.uint8),
        )

    def _hold(self, table: AgentTable, row: int, takeover: Takeover, path: ReferencePath, view: AlongPath) -> float:
        """Follow whatever is on the path, and give way to the opponent and to those alongside that are ahead."""
        speed, wanted = float(table.speed[row]), self._wanted_speed(table, row)
        leads = view.ahead & view.in_path & (view.gap > 0)
        follow = idm_acceleration(self._config.idm, speed, wanted, view.gap[leads], view.speed[leads])
        courted = view.ahead & (view.in_path | (table.id == takeover.opponent)) & ~leads
        courted &= (view.gap > 0) | _goes_first(table, row)
        if not courted.any():
            return follow
        courtesy = idm_acceleration(self._config.idm, speed, wanted, view.gap[courted], view.speed[courted])
        in_the_way = courted & along_path(path, table, row, margin=0.0).in_path & (view.speed < speed)
        return min(follow, courtesy if in_the_way.any() else max(courtesy, -self._config.courtesy_deceleration))

    def _hand_back(
        self, table: AgentTable, row: int, takeover: Takeover, path: ReferencePath, view: AlongPath
    ) -> float:
        """Close the distance to the log that it goes back to, but never into whatever is on the path."""
        log_row, step = self._log_row(table, row), table.step - round(takeover.time_shift / STEP_S)
        x = np.array([table.x[row], self._log.x[log_row, step]])
        y = np.array([table.y[row], self._log.y[log_row, step]])
        s, _ = path.project(x, y)
        log_speed = float(self._log.speed[log_row, step])
        wanted = catch_up(
            self._handback,
            float(s[1] - s[0]),
            float(table.speed[row]),
            log_speed,
            float(self._log.acceleration[log_row, step]),
        )
        leads = view.ahead & view.in_path
        free = log_speed + 2.0 * self._handback.speed_excess
        follow = idm_acceleration(self._config.idm, float(table.speed[row]), free, view.gap[leads], view.speed[leads])
        return min(wanted, follow)

    def _steer(self, table: AgentTable, row: int, path: ReferencePath) -> float:
        """Yaw rate [rad/s] along the path, or along the lane while the way to the side is taken."""
        x, y, yaw, speed = (float(getattr(table, f)[row]) for f in ("x", "y", "yaw", "speed"))
        at = self._lane_map.nearest(table.x[row : row + 1], table.y[row : row + 1], table.yaw[row : row + 1])
        lane_heading = float(at.heading[0])
        s, _ = path.project(table.x[row : row + 1], table.y[row : row + 1])
        target = path.point(float(s[0]) + pursuit_reach(speed)) - np.array([x, y])
        sideways = -np.sin(lane_heading) * target[0] + np.cos(lane_heading) * target[1]
        if not self._side_taken(table, row, lane_heading, float(sideways)):
            return pursuit_yaw_rate(path, x, y, yaw, speed)
        return 2.0 * speed / pursuit_reach(speed) * float(np.sin(lane_heading - yaw))

    def _side_taken(self, table: AgentTable, row: int, lane_heading: float, sideways: float) -> bool:
        """Whether somebody is alongside, or will be soon, where a move by `sideways` [m] to the left would lead."""
        heading = np.full(len(table), lane_heading)
        ahead, left = to_body(table.x - table.x[row], table.y - table.y[row], heading)
        clearance = np.abs(left) - 0.5 * (table.width + table.width[row])
        closing = np.abs(table.speed - table.speed[row]) * self._config.side_horizon
        approaching = np.sign(ahead) * (table.speed - table.speed[row]) < 0
        reach = 0.5 * (table.length + table.length[row]) + self._config.side_gap + np.where(approaching, closing, 0.0)
        taken = (np.abs(ahead) < reach) & (left * sideways > 0) & (clearance < abs(sideways) + self._config.side_margin)
        taken[row] = False
        return abs(sideways) > self._config.side_drift and bool(taken.any())

    def _wanted_speed(self, table: AgentTable, row: int) -> float:
        """Speed [m/s] of the agent's own log where it is now and at this time, whichever is faster, and a reserve."""
        log_row = self._log_row(table, row)
        valid = np.flatnonzero(self._log.valid[log_row])
        distance = np.hypot(self._log.x[log_row, valid] - table.x[row], self._log.y[log_row, valid] - table.y[row])
        here = self._log.speed[log_row, valid[np.argmin(distance)]]
        now = self._log.speed[log_row, min(table.step, valid[-1])]
        return max(float(max(here, now)) + self._config.speed_reserve, self._config.speed_min)

    def _log_row(self, table: AgentTable, row: int) -> int:
        return int(np.searchsorted(self._log.ids, table.id[row]))


def _goes_first(table: AgentTable, row: int) -> BoolArray:
    """(n,) who goes before the agent in `row` where both are alongside; never each before the other.

    Where paths cross, each agent can be ahead on the other's: along the direction between both headings only one is.
    """
    along = (table.x - table.x[row]) * (np.cos(table.yaw) + np.cos(table.yaw[row]))
    along += (table.y - table.y[row]) * (np.sin(table.yaw) + np.sin(table.yaw[row]))
    return (along > 0) | ((along == 0) & (table.id < table.id[row]))
