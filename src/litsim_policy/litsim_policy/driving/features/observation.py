"""Observations of policy C: the features of the paper's Table I, and the way to the agent's goal.

All features are relative to the agents' box centres, divided by fixed scales and clipped to +-LIMIT, float64. The
groups:

- core (4): length, width, speed, acceleration. The paper's table has "height" for the second extent of the box.
- surrounding (7 per slot): see :mod:`.surrounding`.
- road (7): see :mod:`.lanes`.
- ahead (6, optional): agents ahead on the path, see :data:`.way.AHEAD_FEATURES`.
- way (14): see :data:`.way.WAY_FEATURES`; in the paper the policy drives along the reference path to the goal,
  but the paper does not describe these features.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from litsim_policy.driving.features.lanes import ROAD, LaneFeatures
from litsim_policy.driving.features.scales import ACCELERATION, LENGTH, LIMIT, SPEED, WIDTH
from litsim_policy.driving.features.surrounding import SLOT, write_surrounding
from litsim_policy.driving.features.way import AHEAD, WAY, write_ahead, write_way
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.along_path import Poses
from litsim_sim.core.quantities import Flag, Length, Positive, Whole, configuration
from litsim_sim.core.scene import AgentArrays, AgentTable, FloatArray
from litsim_sim.kernels.compiled import Ints, OutFloats2, kernel
from litsim_sim.lane_map.lane_map import LaneMap

CORE = 4  # number of features of the agent itself


@configuration
class ObservationConfig:
    """How surrounding agents are chosen.

    Attributes:
        slots: number of equal sectors, the first centred ahead, then counter-clockwise; in each, the nearest agent is
            observed.
        sight: range beyond which agents are ignored.
        ahead: whether :data:`.way.AHEAD_FEATURES` are included.
    """

    slots: Positive[Whole] = 8
    sight: Positive[Length] = 60.0
    ahead: Flag = False

    @property
    def size(self) -> int:
        """Number of features."""
        return self.ahead_at + (AHEAD if self.ahead else 0) + WAY

    @property
    def ahead_at(self) -> int:
        """Position of the first of :data:`.way.AHEAD_FEATURES`, if they are included."""
        return self.road_at + ROAD

    @property
    def road_at(self) -> int:
        """Position of the first feature of the road, behind those of the surrounding agents."""
        return CORE + SLOT * self.slots


class Observer:
    """Observes agents on a net; independent of runs."""

    def __init__(self, lane_map: LaneMap, config: ObservationConfig | None = None) -> None:
        self.config = config or ObservationConfig()
        self._lane_map, self._road = lane_map, LaneFeatures(lane_map)

    def observe(self, table: AgentTable, tasks: Sequence[DrivingTask], poses: Poses | None = None) -> FloatArray:
        """Features (m, size) of the agents with `tasks` (m), all of which are in `table`.

        If `poses` are given, each agent is observed as if it alone were displaced to its pose.
        """
        return self.features(DrivingScene.of(self._lane_map, table, tasks, poses))

    def features(self, scene: DrivingScene) -> FloatArray:
        """Features (m, size) of the m agents of `scene`."""
        config = self.config
        features = np.zeros((len(scene), config.size))
        if len(scene):
            _write_core(scene.agents.table.arrays, scene.agents.rows, features)
            write_surrounding(scene.agents, config.sight, config.slots, CORE, features)
            self._road.write(scene.agents, config.road_at, features)
            if config.ahead:
                write_ahead(scene.agents, config.sight, config.ahead_at, features)
            write_way(scene, config.sight, features)
            np.minimum(np.maximum(features, -LIMIT, out=features), LIMIT, out=features)
        return features


@kernel
def _write_core(agents: AgentArrays, rows: Ints, features: OutFloats2) -> None:
    """Write the core features of the agents in `rows` (m,) of all `agents` into `features` (m, size)."""
    for i in range(len(rows)):
        own = rows[i]
        features[i, 0], features[i, 1] = agents.length[own] / LENGTH, agents.width[own] / WIDTH
        features[i, 2], features[i, 3] = agents.speed[own] / SPEED, agents.acceleration[own] / ACCELERATION
