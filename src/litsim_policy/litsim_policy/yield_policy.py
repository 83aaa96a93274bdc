"""The rule-based policy: an agent in conflict yields along its reference path, and catches up once it is free."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from litsim_policy.car_following import AlongPath, IdmConfig, along_path, idm_acceleration
from litsim_policy.handback import HandbackConfig, catch_up
from litsim_policy.path import ReferencePath, pursuit_yaw_rate
from litsim_policy.takeover import State, Takeover, TakeoverTable
from litsim_sim.log import Log
from litsim_sim.scenario import Scenario
from litsim_sim.scene import AgentTable, ControlSource, ControlTable


@dataclass(frozen=True)
class YieldConfig:
    """Parameters of :class:`YieldPolicy`.

    Attributes:
        idm: car following behind whatever is on the path.
        courtesy_deceleration: hardest braking [m/s2] for an opponent that is ahead but not yet on the path.
        speed_reserve: faster than the agent's own log by this much at most [m/s] while it is held.
        speed_min: [m/s] that an agent may always drive on a free path, though it stood there in the log.
    """

    idm: IdmConfig = field(
        default_factory=lambda: IdmConfig(headway=0.8, standstill_gap=1.5, acceleration=2.0, deceleration=2.5)
    )
    courtesy_deceleration: float = 3.0
    speed_reserve: float = 1.0
    speed_min: float = 3.0


class YieldPolicy:
    """The policy called `yield`."""

    def __init__(
        self, scenario: Scenario, config: YieldConfig | None = None, handback: HandbackConfig | None = None
    ) -> None:
        self._log: Log = scenario.log
        self._config = config or YieldConfig()
        self._handback = handback or HandbackConfig()

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Controls of every agent that is held or handed back."""
        driven = [t for t in takeovers.takeovers if t.state != State.RELEASED]
        if not driven:
            return ControlTable.empty(table.step)
        rows = table.rows(np.array([t.agent for t in driven], np.int64))
        acceleration = np.zeros(len(driven))
        yaw_rate = np.zeros(len(driven))
        for k, (takeover, row) in enumerate(zip(driven, rows.tolist(), strict=True)):
            path = ReferencePath.through(takeover.reference_path)
            view = along_path(path, table, row)
            if takeover.state == State.HELD:
                acceleration[k] = self._hold(table, row, takeover, view)
            else:
                acceleration[k] = self._hand_back(table, row, path, view)
            yaw_rate[k] = pursuit_yaw_rate(
                path, float(table.x[row]), float(table.y[row]), float(table.yaw[row]), float(table.speed[row])
            )
        source = [ControlSource.POLICY if t.state == State.HELD else ControlSource.HANDBACK for t in driven]
        return ControlTable(
            table.step,
            table.id[rows],
            acceleration,
            table.speed[rows] * yaw_rate,
            yaw_rate,
            np.array(source, np.uint8),
        )

    def _hold(self, table: AgentTable, row: int, takeover: Takeover, view: AlongPath) -> float:
        """Follow whatever is on the path, and the opponent if it is ahead, wherever it is."""
        speed, wanted = float(table.speed[row]), self._wanted_speed(table, row)
        leads = view.ahead & view.in_path
        follow = idm_acceleration(self._config.idm, speed, wanted, view.gap[leads], view.speed[leads])
        opponent = table.row(takeover.opponent)
        if opponent < 0 or opponent == row or not view.ahead[opponent] or leads[opponent]:
            return follow
        at = slice(opponent, opponent + 1)
        courtesy = idm_acceleration(self._config.idm, speed, wanted, view.gap[at], view.speed[at])
        return min(follow, max(courtesy, -self._config.courtesy_deceleration))

    def _hand_back(self, table: AgentTable, row: int, path: ReferencePath, view: AlongPath) -> float:
        """Close the distance to the log, but never into whatever is on the path."""
        log_row, step = self._log_row(table, row), table.step
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
