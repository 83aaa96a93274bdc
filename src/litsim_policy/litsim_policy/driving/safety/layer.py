"""The safety layer between policy C's network and the vehicle: limits that always hold, and a guard for emergencies.

For any command of the network, an agent keeps comfort bounds, and touches no other as far as the look-ahead can tell.
Only the guard may brake harder than is comfortable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_policy.driving.look_ahead import first_touch, rolled_out, steps_of
from litsim_policy.driving.safety.comfort import limited
from litsim_policy.driving.safety.evasion import best_choice, evasive_commands
from litsim_policy.driving.task import DrivingScene
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.quantities import Acceleration, Flag, Horizon, Length, NonNegative, Positive, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray


@configuration
class SafetyConfig:
    """The guard against contacts; the limits of :mod:`.comfort` always hold.

    Attributes:
        contact: brake or steer where the command leads into another box within `horizon`.
        braking_max: of the guard in an emergency, the most that the vehicle can do.
        horizon: of the look-ahead for other boxes.
        margin: distance kept to other boxes.
    """

    contact: Flag = True
    braking_max: Positive[Acceleration] = 8.0
    horizon: Horizon = 1.2
    margin: NonNegative[Length] = 0.15


@dataclass
class SafeCommands:
    """Commands after the layer; arrays (m,).

    Attributes:
        acceleration: [m/s2].
        yaw_rate: [rad/s].
        guarded: whether the guard has changed what the agent does.
    """

    acceleration: FloatArray
    yaw_rate: FloatArray
    guarded: BoolArray


class SafetyLayer:
    """The limits and the guard."""

    def __init__(self, config: SafetyConfig | None = None) -> None:
        self.config = config or SafetyConfig()

    def guard(self, scene: DrivingScene, acceleration: FloatArray, yaw_rate: FloatArray) -> SafeCommands:
        """Returns the requested commands (m,) [m/s2], [rad/s] of agents of `scene`, with the least changes needed."""
        agents, guarded = scene.agents, np.zeros(len(scene), np.bool_)
        safe = limited(acceleration, yaw_rate, agents.table.arrays, agents.rows)
        if self.config.contact and len(scene):
            safe, guarded = self._guarded(agents, safe)
        return SafeCommands(safe[:, 0], safe[:, 1], guarded)

    def _guarded(self, agents: PathFollowers, commands: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Returns the least changes to `commands` (m, 2) with which agents touch no other, and which were changed (m,).

        If no choice does, the one that touches latest, and of these the one that brakes hardest.
        """
        rows = agents.rows
        touches = self._first_touch(agents.table, rows, commands[:, None])[:, 0] < np.inf
        touching = touches.nonzero()[0]
        if not len(touching):
            return commands, touches
        choices = evasive_commands(
            commands[touching],
            agents.speed[touching],
            agents.table.yaw_rate[rows[touching]],
            agents.path_yaw_rate[touching],
            agents.lane_yaw_rate[touching],
            self.config.braking_max,
        )
        touch = self._first_touch(agents.table, rows[touching], choices)
        chosen = commands.copy()
        chosen[touching] = choices[np.arange(len(touching)), best_choice(choices, touch)]
        stands = -agents.speed / STEP_S  # [m/s2] with which agents stop within a step; harder has no effect
        moved = np.maximum(chosen[:, 0], stands) != np.maximum(commands[:, 0], stands)
        moved |= (chosen[:, 1] != commands[:, 1]) & (agents.speed > 0.0)
        return chosen, moved

    def _first_touch(self, table: AgentTable, rows: IntArray, commands: FloatArray) -> FloatArray:
        """Returns times (m, c) [s] of the first touch under commands (m, c, 2) of the agents in `rows` (m,)."""
        instants = steps_of(self.config.horizon)
        return first_touch(table, rows, rolled_out(table, rows, commands, instants), self.config.margin)
