"""The rule-based policy `yield`: an agent in conflict yields along its reference path, and returns to its log later."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from litsim_policy.driving.handback import COMFORTABLE, SPEED_EXCESS, along_log
from litsim_policy.driving.policy import Policy
from litsim_policy.driving.safety.following import braking_needed
from litsim_policy.driving.task import lag_of, opponent_of
from litsim_policy.driving.walking import walk
from litsim_policy.driving.yielding_rules import give_way, side_is_taken, wait_for_crossing
from litsim_policy.motion.car_following import idm_acceleration
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.stop_lines import StopLines, idm_at_signals
from litsim_sim.core.scene import AgentTable, BoolArray, ControlSource, ControlTable, FloatArray, IntArray
from litsim_sim.core.takeover import Takeover, TakeoverState, TakeoverTable
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.setting import Setting

SPEED_RESERVE = 1.0  # [m/s] most by which a held agent drives faster than its log
SPEED_MIN = 3.0  # [m/s] always allowed on a free path, even if the log stood there
CLOSE_UP = 5.0  # [m] gap to the agent ahead, below which overlaps in the log itself are considered
SOURCES = {
    TakeoverState.HELD: int(ControlSource.POLICY),
    TakeoverState.OWN_INTENT: int(ControlSource.POLICY),
    TakeoverState.HANDBACK: int(ControlSource.HANDBACK),
    TakeoverState.RELEASED: int(ControlSource.LATE),
}


class YieldPolicy(Policy):
    """The policy called `yield`."""

    batched = True
    drives_walkers = True

    def __init__(self, scenario: Setting) -> None:
        self._log: Log = scenario.log
        self._overlaps = scenario.log_overlaps
        self._lane_map = scenario.lane_map
        self._stop_lines = StopLines(scenario.signals)

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Returns controls of all agents that are held, handed back, or released to a lagged log."""
        listed = [t for t in takeovers.takeovers if t.state != TakeoverState.RELEASED or t.time_shift > 0.0]
        if not listed:
            return ControlTable.empty(table.step)
        rows = table.rows(np.array([t.agent for t in listed], np.int64))
        acceleration, yaw_rate = np.zeros(len(listed)), np.zeros(len(listed))
        walks = table.obstacle[rows]
        vehicles = [k for k in range(len(listed)) if not walks[k]]
        on = [k for k in vehicles if listed[k].state.drives_on]
        back = [k for k in vehicles if listed[k].state == TakeoverState.HANDBACK]
        for chosen, rule in ((on, self._hold), (back, self._hand_back)):
            if chosen:
                paths = PathBatch.of([listed[k].reference_path for k in chosen])
                agents = PathFollowers(self._lane_map, table, rows[chosen], paths)
                asked = rule(agents, [listed[k] for k in chosen])
                acceleration[chosen] = wait_for_crossing(
                    asked, paths, agents.s, table.arrays, agents.rows, table.obstacle
                )
                yaw_rate[chosen] = self._steer(agents)
        chosen = [k for k, t in enumerate(listed) if t.state != TakeoverState.RELEASED and walks[k]]
        if chosen:
            agents = PathFollowers.of_takeovers(self._lane_map, table, [listed[k] for k in chosen])
            acceleration[chosen] = walk(self._log, agents, np.array([lag_of(listed[k]) for k in chosen]))
            yaw_rate[chosen] = agents.path_yaw_rate
        source = np.array([SOURCES[t.state] for t in listed], np.uint8)
        return ControlTable.without_slip(table, rows, acceleration, yaw_rate, source)

    def _hold(self, agents: PathFollowers, takeovers: Sequence[Takeover]) -> FloatArray:
        """Accelerations (m,) [m/s2] with which agents follow others on their paths, stop at red, and give way."""
        wanted, opponent = self._wanted_speed(agents), np.array([opponent_of(t) for t in takeovers])
        model = COMFORTABLE.values
        acceleration = give_way(agents.view, agents.table.arrays, agents.rows, wanted, opponent, model)
        return idm_at_signals(COMFORTABLE, agents.speed, wanted, acceleration, self._stop_lines.of(agents))

    def _hand_back(self, agents: PathFollowers, takeovers: Sequence[Takeover]) -> FloatArray:
        """Returns accelerations (m,) [m/s2] that close the distance to the log behind agents on the path.

        Agents that overlap in the log itself are ignored, so that the overlap can be reached.
        """
        view, lag = agents.view, np.array([lag_of(t) for t in takeovers])
        wanted, log_speed = along_log(self._log, agents, lag)
        free = log_speed + 2.0 * SPEED_EXCESS
        leads = agents.leaders.leads & ~self._overlapped_in_log(agents, agents.table.step - lag)
        follow = idm_acceleration(COMFORTABLE, agents.speed, free, view.gap, view.speed, leads)
        follow = np.maximum(follow, -np.maximum(COMFORTABLE.deceleration, braking_needed(agents, leads)))
        line = self._stop_lines.of(agents)
        return idm_at_signals(COMFORTABLE, agents.speed, free, np.minimum(wanted, follow), line)

    def _overlapped_in_log(self, agents: PathFollowers, now: IntArray) -> BoolArray:
        """Mask (m, w) of near agents ahead that overlap in the log as well, about steps `now` (m,) of the logs."""
        view, table, log_rows = agents.view, agents.table, self._log_rows(agents)
        overlapped, of_ego = np.zeros(view.gap.shape, np.bool_), table.of_ego
        for k, column, row in view.pairs(agents.leaders.leads & (view.gap < CLOSE_UP)):
            if of_ego[row]:
                continue
            a, b = int(log_rows[k]), int(self._log.ids.searchsorted(table.id[row]))
            overlapped[k, column] = self._overlaps.meets(a, b, now[k], table.x[row], table.y[row])
        return overlapped

    def _steer(self, agents: PathFollowers) -> FloatArray:
        """Yaw rates (m,) [rad/s] along the paths, or along the lanes if the side to which a path leads is taken."""
        taken = side_is_taken(agents.table.arrays, agents.rows, agents.lane.heading, agents.target)
        return np.where(taken, agents.lane_yaw_rate, agents.path_yaw_rate)

    def _wanted_speed(self, agents: PathFollowers) -> FloatArray:
        """Desired speeds (m,) [m/s]: the log's at the agent's position or now, if greater, plus a reserve."""
        log, rows = self._log, self._log_rows(agents)
        distance = np.hypot(log.x[rows] - agents.x[:, None], log.y[rows] - agents.y[:, None])
        here = np.argmin(np.where(log.valid[rows], distance, np.inf), axis=1)
        now = np.minimum(agents.table.step, log.last_step[rows])
        logged = np.maximum(log.speed[rows, here], log.speed[rows, now])
        return np.maximum(logged + SPEED_RESERVE, SPEED_MIN)

    def _log_rows(self, agents: PathFollowers) -> IntArray:
        """Returns rows (m,) of the agents in the log."""
        return self._log.ids.searchsorted(agents.table.id[agents.rows])
