"""The rule-based policy: an agent in conflict yields along its reference path, and catches up once it is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from litsim_policy.driving.handback import HandbackConfig, catch_up
from litsim_policy.motion.car_following import IdmConfig, idm_acceleration
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_sim.core.geometry import to_body
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Speed, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, ControlSource, ControlTable, FloatArray, IntArray
from litsim_sim.core.takeover import Takeover, TakeoverState, TakeoverTable
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

SOURCES = {
    TakeoverState.HELD: ControlSource.POLICY,
    TakeoverState.HANDBACK: ControlSource.HANDBACK,
    TakeoverState.RELEASED: ControlSource.LATE,
}


@configuration
class YieldConfig:
    """Parameters of :class:`YieldPolicy`.

    Attributes:
        idm: car following behind whatever is on the path.
        courtesy_deceleration: hardest braking for an opponent that is ahead but not yet on the path, or
            alongside without being in the way.
        speed_reserve: faster than the agent's own log by this much at most while it is held.
        speed_min: that an agent may always drive on a free path, though it stood there in the log.
        side_gap: free road behind and ahead that a move to the side needs.
        side_horizon: for which whoever approaches is expected to go on doing so.
        side_margin: distance to the side that is kept to others.
        side_drift: distance to the side that counts as no move.
    """

    idm: IdmConfig = field(
        default_factory=lambda: IdmConfig(headway=0.8, standstill_gap=1.5, acceleration=2.0, deceleration=2.5)
    )
    courtesy_deceleration: NonNegative[Acceleration] = 3.0
    speed_reserve: NonNegative[Speed] = 1.0
    speed_min: NonNegative[Speed] = 3.0
    side_gap: NonNegative[Length] = 1.0
    side_horizon: NonNegative[Duration] = 1.5
    side_margin: NonNegative[Length] = 0.3
    side_drift: NonNegative[Length] = 0.05


class YieldPolicy:
    """The policy called `yield`."""

    def __init__(self, scenario: Scenario, config: YieldConfig, handback: HandbackConfig) -> None:
        self._log: Log = scenario.log
        self._lane_map = scenario.lane_map
        self._config = config
        self._handback = handback

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Controls of every agent that is held or handed back, and of who is released to a log that lags."""
        listed = [t for t in takeovers.takeovers if t.state != TakeoverState.RELEASED or t.time_shift > 0.0]
        if not listed:
            return ControlTable.empty(table.step)
        rows = table.rows(np.array([t.agent for t in listed], np.int64))
        state = np.array([t.state for t in listed])
        acceleration, yaw_rate = np.zeros(len(listed)), np.zeros(len(listed))
        for which, rule in ((TakeoverState.HELD, self._hold), (TakeoverState.HANDBACK, self._hand_back)):
            at = np.flatnonzero(state == which)
            if len(at):
                paths = PathBatch([listed[k].reference_path for k in at])
                agents = PathFollowers(self._lane_map, table, rows[at], paths)
                acceleration[at] = rule(agents, [listed[k] for k in at])
                yaw_rate[at] = self._steer(agents)
        return ControlTable(
            table.step,
            table.id[rows],
            acceleration,
            table.speed[rows] * yaw_rate,
            yaw_rate,
            np.array([SOURCES[t.state] for t in listed], np.uint8),
        )

    def _hold(self, agents: PathFollowers, takeovers: Sequence[Takeover]) -> FloatArray:
        """Accelerations (m,) [m/s2] of agents that follow whatever is on their paths, and give way.

        They give way to their opponents and to those alongside that are ahead.
        """
        view, table, idm = agents.view, agents.table, self._config.idm
        wanted = self._wanted_speed(agents)
        leads = view.ahead & view.in_path & (view.gap > 0)
        follow = idm_acceleration(idm, agents.speed, wanted, view.gap, view.speed, leads)
        opponent = np.array([t.opponent for t in takeovers])[:, None]
        courted = view.ahead & (view.in_path | (table.id == opponent)) & ~leads
        courted &= (view.gap > 0) | _goes_first(agents)
        courtesy = idm_acceleration(idm, agents.speed, wanted, view.gap, view.speed, courted)
        in_the_way = (courted & (view.aside < 0.0) & (view.speed < agents.speed[:, None])).any(axis=1)
        courtesy = np.where(in_the_way, courtesy, np.maximum(courtesy, -self._config.courtesy_deceleration))
        return np.where(courted.any(axis=1), np.minimum(follow, courtesy), follow)

    def _hand_back(self, agents: PathFollowers, takeovers: Sequence[Takeover]) -> FloatArray:
        """Accelerations (m,) [m/s2] that close the distance to the log, but never into whatever is on the path."""
        log, view = self._log, agents.view
        shift = np.array([round(t.time_shift / STEP_S) for t in takeovers])
        at = self._log_rows(agents), agents.table.step - shift
        log_speed = log.speed[at]
        behind = agents.to_goal(log.x[at], log.y[at])
        wanted = catch_up(self._handback, behind, agents.speed, log_speed, log.acceleration[at])
        free = log_speed + 2.0 * self._handback.speed_excess
        leads = view.ahead & view.in_path
        follow = idm_acceleration(self._config.idm, agents.speed, free, view.gap, view.speed, leads)
        return np.minimum(wanted, follow)

    def _steer(self, agents: PathFollowers) -> FloatArray:
        """Yaw rates (m,) [rad/s] along the paths, or along the lanes while the way to the side is taken."""
        heading = agents.lane.heading
        target = agents.target - np.column_stack([agents.x, agents.y])
        sideways = -np.sin(heading) * target[:, 0] + np.cos(heading) * target[:, 1]
        return np.where(self._side_taken(agents, sideways), agents.lane_yaw_rate, agents.path_yaw_rate)

    def _side_taken(self, agents: PathFollowers, sideways: FloatArray) -> BoolArray:
        """(m,) whether somebody is alongside, or will be soon, where moves by `sideways` (m,) [m] to the left lead."""
        table, rows, config = agents.table, agents.rows, self._config
        dx, dy = table.x - agents.x[:, None], table.y - agents.y[:, None]
        ahead, left = to_body(dx, dy, agents.lane.heading[:, None])
        clearance = np.abs(left) - 0.5 * (table.width + table.width[rows, None])
        faster = table.speed - agents.speed[:, None]
        approaching = np.sign(ahead) * faster < 0
        reach = 0.5 * (table.length + table.length[rows, None]) + config.side_gap
        reach += np.where(approaching, np.abs(faster) * config.side_horizon, 0.0)
        move = sideways[:, None]
        taken = (np.abs(ahead) < reach) & (left * move > 0) & (clearance < np.abs(move) + config.side_margin)
        taken[np.arange(len(agents)), rows] = False
        return np.asarray((np.abs(sideways) > config.side_drift) & taken.any(axis=1))

    def _wanted_speed(self, agents: PathFollowers) -> FloatArray:
        """(m,) speeds [m/s] of the agents' own logs where they are now and at this time.

        Of both, the faster, and a reserve.
        """
        log, rows = self._log, self._log_rows(agents)
        distance = np.hypot(log.x[rows] - agents.x[:, None], log.y[rows] - agents.y[:, None])
        here = np.argmin(np.where(log.valid[rows], distance, np.inf), axis=1)
        now = np.minimum(agents.table.step, log.last_step[rows])
        logged = np.maximum(log.speed[rows, here], log.speed[rows, now])
        return np.maximum(logged + self._config.speed_reserve, self._config.speed_min)

    def _log_rows(self, agents: PathFollowers) -> IntArray:
        """(m,) rows of the agents in the log."""
        return np.searchsorted(self._log.ids, agents.table.id[agents.rows])


def _goes_first(agents: PathFollowers) -> BoolArray:
    """(m, n) who goes before each agent where both are alongside; never each before the other.

    Where paths cross, each agent can be ahead on the other's: along the direction between both headings only one is.
    """
    table, yaw = agents.table, agents.yaw[:, None]
    along = (table.x - agents.x[:, None]) * (np.cos(table.yaw) + np.cos(yaw))
    along += (table.y - agents.y[:, None]) * (np.sin(table.yaw) + np.sin(yaw))
    return np.asarray((along > 0) | ((along == 0) & (table.id < table.id[agents.rows, None])))
