"""The rule-based policy `yield`: an agent in conflict yields along its reference path, and returns to its log later."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from functools import cached_property

import numpy as np

from litsim_policy.driving.handback import COMFORTABLE, HandbackConfig, along_log
from litsim_policy.driving.policy import Policy
from litsim_policy.driving.safety.config import SafetyConfig
from litsim_policy.driving.safety.following import braking_needed
from litsim_policy.driving.task import opponent_of
from litsim_policy.driving.yielding_rules import (
    RuleValues,
    give_way,
    keep_distance,
    make_room,
    side_is_taken,
    wait_for_crossing,
)
from litsim_policy.motion.car_following import IdmConfig, idm_acceleration
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.stop_lines import StopLines, idm_at_signals
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Speed, configuration
from litsim_sim.core.scene import (
    STEP_S,
    AgentTable,
    BoolArray,
    ControlSource,
    ControlTable,
    FloatArray,
    IntArray,
)
from litsim_sim.core.takeover import Takeover, TakeoverState, TakeoverTable
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.setting import Setting

CLOSE_UP = 5.0  # [m] gap to the agent ahead, below which overlaps in the log itself are considered
SOURCES = {
    TakeoverState.HELD: int(ControlSource.POLICY),
    TakeoverState.HANDBACK: int(ControlSource.HANDBACK),
    TakeoverState.RELEASED: int(ControlSource.LATE),
}


@configuration
class YieldConfig:
    """Parameters of :class:`YieldPolicy`.

    Attributes:
        idm: car following behind agents on the path.
        courtesy_deceleration: hardest braking for an opponent that is ahead but not yet on the path, or
            alongside without being in the way.
        speed_reserve: most by which a held agent drives faster than its log.
        speed_min: speed that is always allowed on a free path, even if the log stood there.
        side_gap: least gap behind and ahead for a lateral move.
        side_horizon: time for which approaching agents are expected to continue.
        side_margin: lateral distance kept to others.
        side_drift: lateral distance that does not count as a move.
        room_horizon: time for which merging agents are expected to continue; policy litsim makes room for them.
        crossing_horizon: time for which crossing agents are expected to continue; policy litsim waits for them.
        crossing_margin: distance kept to crossing agents.
    """

    idm: IdmConfig = field(default_factory=lambda: COMFORTABLE)
    courtesy_deceleration: NonNegative[Acceleration] = 3.0
    speed_reserve: NonNegative[Speed] = 1.0
    speed_min: NonNegative[Speed] = 3.0
    side_gap: NonNegative[Length] = 1.0
    side_horizon: NonNegative[Duration] = 1.5
    side_margin: NonNegative[Length] = 0.3
    side_drift: NonNegative[Length] = 0.05
    room_horizon: NonNegative[Duration] = 2.5
    crossing_horizon: NonNegative[Duration] = 3.0
    crossing_margin: NonNegative[Length] = 0.5

    @cached_property
    def values(self) -> RuleValues:
        """The values that the rules take."""
        return RuleValues(
            self.idm.values,
            self.courtesy_deceleration,
            self.side_gap,
            self.side_horizon,
            self.side_margin,
            self.side_drift,
            self.room_horizon,
            self.crossing_horizon,
            self.crossing_margin,
        )


class YieldPolicy(Policy):
    """The policy called `yield`."""

    batched = True

    @classmethod
    def read(cls, read: ParameterReader) -> Callable[[Setting], Policy]:
        """See :class:`litsim_sim.core.plugins.Configured`."""
        rules, handback = read(YieldConfig()), read(HandbackConfig(), "handback.")
        return lambda scenario: cls(scenario, rules, handback)

    def __init__(self, scenario: Setting, config: YieldConfig, handback: HandbackConfig) -> None:
        self._log: Log = scenario.log
        self._overlaps = scenario.log_overlaps
        self._lane_map = scenario.lane_map
        self._config = config
        self._handback = handback
        self._stop_lines = StopLines(scenario.signals)

    @property
    def comfortable_braking(self) -> float:
        """Braking [m/s2] that the car following takes to be comfortable."""
        return self._config.idm.deceleration

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Returns controls of all agents that are held, handed back, or released to a lagged log."""
        listed = [t for t in takeovers.takeovers if t.state != TakeoverState.RELEASED or t.time_shift > 0.0]
        if not listed:
            return ControlTable.empty(table.step)
        rows = table.rows(np.array([t.agent for t in listed], np.int64))
        acceleration, yaw_rate = np.zeros(len(listed)), np.zeros(len(listed))
        for which, rule in ((TakeoverState.HELD, self._hold), (TakeoverState.HANDBACK, self._hand_back)):
            at = [k for k, t in enumerate(listed) if t.state == which]
            if at:
                paths = PathBatch([listed[k].reference_path for k in at])
                agents = PathFollowers(self._lane_map, table, rows[at], paths)
                acceleration[at] = rule(agents, [listed[k] for k in at])
                yaw_rate[at] = self._steer(agents)
        source = np.array([SOURCES[t.state] for t in listed], np.uint8)
        return ControlTable.without_slip(table, rows, acceleration, yaw_rate, source)

    def _hold(self, agents: PathFollowers, takeovers: Sequence[Takeover]) -> FloatArray:
        """Accelerations (m,) [m/s2] with which agents follow others on their paths, stop at red, and give way."""
        wanted, opponent = self._wanted_speed(agents), np.array([opponent_of(t) for t in takeovers])
        rules = self._config.values
        acceleration = give_way(agents.view, agents.table.arrays, agents.rows, wanted, opponent, rules)
        return idm_at_signals(self._config.idm, agents.speed, wanted, acceleration, self._stop_lines.of(agents))

    def _hand_back(self, agents: PathFollowers, takeovers: Sequence[Takeover]) -> FloatArray:
        """Returns accelerations (m,) [m/s2] that close the distance to the log behind agents on the path.

        Agents that overlap in the log itself are ignored, so that the overlap can be reached.
        """
        log, view = self._log, agents.view
        shift = np.array([round(t.time_shift / STEP_S) for t in takeovers])
        at = self._log_rows(agents), agents.table.step - shift
        wanted = along_log(self._handback, log, agents, shift)
        free = log.speed[at] + 2.0 * self._handback.speed_excess
        leads = agents.leaders.leads & ~self._overlapped_in_log(agents, at[0], at[1])
        follow = idm_acceleration(self._config.idm, agents.speed, free, view.gap, view.speed, leads)
        follow = np.maximum(follow, -np.maximum(self.comfortable_braking, braking_needed(agents, leads)))
        line = self._stop_lines.of(agents)
        return idm_at_signals(self._config.idm, agents.speed, free, np.minimum(wanted, follow), line)

    def _overlapped_in_log(self, agents: PathFollowers, log_rows: IntArray, now: IntArray) -> BoolArray:
        """Mask (m, w) of near agents ahead that overlap in the log as well, about steps `now` (m,) of the logs."""
        view, table = agents.view, agents.table
        overlapped, of_ego = np.zeros(view.gap.shape, np.bool_), table.of_ego
        for k, column, row in view.pairs(agents.leaders.leads & (view.gap < CLOSE_UP)):
            if of_ego[row]:
                continue
            a, b = int(log_rows[k]), int(self._log.ids.searchsorted(table.id[row]))
            overlapped[k, column] = self._overlaps.meets(a, b, now[k], table.x[row], table.y[row])
        return overlapped

    def _steer(self, agents: PathFollowers) -> FloatArray:
        """Yaw rates (m,) [rad/s] along the paths, or along the lanes if the side to which a path leads is taken."""
        return np.where(self.side_taken(agents), agents.lane_yaw_rate, agents.path_yaw_rate)

    def side_taken(self, agents: PathFollowers, *, or_will_be: bool = False) -> BoolArray:
        """Mask (m,) of agents with paths to a side that is taken; with `or_will_be`, also by merging agents."""
        rules, lane_heading = self._config.values, agents.lane.heading
        coming_over = rules.side_horizon if or_will_be else 0.0
        return side_is_taken(agents.table.arrays, agents.rows, lane_heading, agents.target, rules, coming_over)

    def hold_to_rules(self, agents: PathFollowers, wanted: FloatArray, safe: SafetyConfig) -> FloatArray:
        """Limit accelerations `wanted` (m,) [m/s2] by the rules of :mod:`.yielding_rules` and red lights.

        Agents keep their distance to leaders, with the parameters `safe`, wait for crossing agents, make room for
        merging ones, and stop at red.
        """
        rules, table, rows = self._config.values, agents.table, agents.rows
        kept = keep_distance(wanted, agents.speed, table.length[rows], agents.leaders, rules, safe.values)
        kept = wait_for_crossing(kept, agents.paths.arrays, agents.s, table.arrays, rows, rules)
        kept = make_room(kept, table.arrays, rows, agents.lane.heading, rules)
        line = self._stop_lines.of(agents)
        if np.isinf(line).all():
            return kept
        return idm_at_signals(self._config.idm, agents.speed, self._wanted_speed(agents), kept, line)

    def _wanted_speed(self, agents: PathFollowers) -> FloatArray:
        """Desired speeds (m,) [m/s]: the log's at the agent's position or now, if greater, plus `speed_reserve`."""
        log, rows = self._log, self._log_rows(agents)
        distance = np.hypot(log.x[rows] - agents.x[:, None], log.y[rows] - agents.y[:, None])
        here = np.argmin(np.where(log.valid[rows], distance, np.inf), axis=1)
        now = np.minimum(agents.table.step, log.last_step[rows])
        logged = np.maximum(log.speed[rows, here], log.speed[rows, now])
        return np.maximum(logged + self._config.speed_reserve, self._config.speed_min)

    def _log_rows(self, agents: PathFollowers) -> IntArray:
        """Returns rows (m,) of the agents in the log."""
        return self._log.ids.searchsorted(agents.table.id[agents.rows])
