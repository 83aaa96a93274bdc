"""The safety layer between policy C's network and the vehicle: limits that always hold, and optional guards.

For any command of the network, an agent keeps comfort bounds, does not run into the agent ahead, touches no other, and
stays on the road, as far as the look-ahead can tell. Only a guard may brake harder than is comfortable. All
interventions are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_policy.driving.look_ahead import first_touch, rolled_out, stay_on_road, steps_of
from litsim_policy.driving.safety.comfort import ACCELERATION_MAX, limited
from litsim_policy.driving.safety.config import SafetyConfig
from litsim_policy.driving.safety.evasion import best_choice, evasive_commands
from litsim_policy.driving.safety.following import following_cap, stopping_cap
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.stop_lines import StopLines
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.signals import LinkSignals

GUARDS = ("limits", "following", "contact", "road")


@dataclass
class SafeCommands:
    """Commands after the layer; arrays (m,).

    Attributes:
        acceleration: [m/s2].
        yaw_rate: [rad/s].
        changed: (m, 4) which of :data:`GUARDS` changed what the agent does.
    """

    acceleration: FloatArray
    yaw_rate: FloatArray
    changed: BoolArray

    @property
    def guarded(self) -> BoolArray:
        """Mask (m,) of agents for which a guard, not only a limit, has intervened."""
        return np.asarray(self.changed[:, 1:].any(axis=1))


class SafetyLayer:
    """The safety layer on one net.

    Attributes:
        interventions: number of agent-steps in which each guard has intervened since the layer was made.
    """

    def __init__(
        self, lane_map: LaneMap, config: SafetyConfig | None = None, signals: LinkSignals | None = None
    ) -> None:
        self.config = config or SafetyConfig()
        self._stop_lines = StopLines(signals)
        self.interventions = dict.fromkeys(GUARDS, 0)
        self.agent_steps = 0
        self.lane_map = lane_map

    def apply(
        self, table: AgentTable, tasks: Sequence[DrivingTask], acceleration: FloatArray, yaw_rate: FloatArray
    ) -> SafeCommands:
        """Returns the safe commands of the agents with `tasks` (m); see :meth:`guard`."""
        return self.guard(DrivingScene.of(self.lane_map, table, tasks), acceleration, yaw_rate)

    def guard(self, scene: DrivingScene, acceleration: FloatArray, yaw_rate: FloatArray) -> SafeCommands:
        """Returns the commands of the m agents of `scene`, with the least changes needed.

        Args:
            scene: the agents, their paths, and all other agents.
            acceleration, yaw_rate: (m,) requested [m/s2], [rad/s].
        """
        config, agents = self.config, scene.agents
        changed = np.zeros((len(scene), len(GUARDS)), np.bool_)
        safe, changed[:, 0] = limited(acceleration, yaw_rate, agents.table.arrays, agents.rows)
        cap = np.full(len(scene), ACCELERATION_MAX)
        if config.following:
            cap = following_cap(config, agents)
            lines = self._stop_lines.of(agents)
            if (lines < np.inf).any():
                cap = np.minimum(cap, stopping_cap(config, agents, lines))
        stands = stopping(agents.speed)
        changed[:, 1] = np.maximum(cap, stands) < np.maximum(safe[:, 0], stands)
        safe[:, 0] = np.minimum(safe[:, 0], cap)
        if (config.contact or config.road) and len(scene):
            safe, changed[:, 2], changed[:, 3] = self._guarded(agents, safe, cap)
        self.agent_steps += len(scene)
        for name, count in zip(GUARDS, changed.sum(axis=0).tolist(), strict=True):
            self.interventions[name] += count
        return SafeCommands(safe[:, 0], safe[:, 1], changed)

    def _guarded(
        self, agents: PathFollowers, commands: FloatArray, cap: FloatArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Returns the least changes to `commands` (m, 2) with which agents touch no other and stay on the road.

        If no choice does, the one that touches latest, and of these the one that brakes hardest.

        Args:
            agents: m agents.
            commands: accelerations [m/s2] and yaw rates [rad/s].
            cap: (m,) acceleration that the agent ahead allows [m/s2].

        Returns:
            the commands (m, 2), and which of them (m,) were changed for contact, and for the road.
        """
        config, rows = self.config, agents.rows
        first, on_road = self._look_ahead(agents.table, rows, commands[:, None])
        touches = config.contact & (first[:, 0] < np.inf)
        leaves = config.road & ~on_road[:, 0]
        at = (touches | leaves).nonzero()[0]
        if not len(at):
            return commands, touches, leaves
        choices = evasive_commands(
            commands[at],
            cap[at],
            agents.speed[at],
            agents.table.yaw_rate[rows[at]],
            agents.path_yaw_rate[at],
            agents.lane_yaw_rate[at],
            config.braking_max,
        )
        touch, stays = self._look_ahead(agents.table, rows[at], choices)
        if not config.contact:
            touch[:] = np.inf
        stays |= not config.road or ~stays.any(axis=1, keepdims=True)
        chosen = commands.copy()
        chosen[at] = choices[np.arange(len(at)), best_choice(choices, touch, stays)]
        stands = stopping(agents.speed)
        moved = np.maximum(chosen[:, 0], stands) != np.maximum(commands[:, 0], stands)
        moved |= (chosen[:, 1] != commands[:, 1]) & (agents.speed > 0.0)
        return chosen, moved & touches, moved & leaves

    def _look_ahead(self, table: AgentTable, rows: IntArray, commands: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Returns the outcome of commands (m, c, 2) of the agents in `rows` (m,).

        Returns:
            time of the first touch (m, c) [s], infinite where there is none, and whether the agent stays on the road
            (m, c).
        """
        config = self.config
        instants, road = steps_of(config.horizon), steps_of(config.road_horizon)
        poses = rolled_out(table, rows, commands, max(instants, road))
        touch = first_touch(table, rows, poses, instants, config.margin)
        return touch, stay_on_road(self.lane_map, table, rows, poses, road - 1)


def stopping(speed: FloatArray) -> FloatArray:
    """Accelerations (m,) [m/s2] with which agents at `speed` (m,) [m/s] stop within a step; harder has no effect."""
    return -speed / STEP_S
