"""Observations of the baselines `gail` and `rail`: own vehicle, lane, route, and beams to the surrounding boxes.

After Kuefler 2017 and Bhattacharyya 2019 (sisl/ngsim_env), without features that are constant here (driving backwards)
or implied by others (collision, off the road), but with distances to the edges of the road and the direction of the
route, since not every road here is a highway. Neither logs nor conflicts are part of it.

All features are relative to the agents' box centres, divided by fixed scales and clipped to +-LIMIT, float64. The
groups:

- own (3): length, width, speed.
- road (7): as for policy C, see :mod:`.lanes`.
- way (2): heading of the reference path half a pursuit reach ahead, and one and a half.
- beams (2 for each): distance to the nearest box in that direction, 1 if there is none within BEAM, and its rate of
  change; the first beam points ahead, the others follow counter-clockwise.
"""

from __future__ import annotations

import math

import numpy as np

from litsim_policy.driving.features.lanes import ROAD, LaneFeatures
from litsim_policy.driving.features.scales import HEADING, LENGTH, LIMIT, SPEED, WIDTH
from litsim_policy.motion.along_path import PoseArrays
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import directions_ahead
from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.scene import AgentArrays, FloatArray
from litsim_sim.kernels.compiled import Floats2, Ints, kernel
from litsim_sim.lane_map.lane_map import LaneMap

BEAMS = 20
BEAM = 50.0  # [m] range of a beam
RATE = 10.0  # [m/s] scale of the rates of change along beams
OWN, WAY = 3, 2
SIZE = OWN + ROAD + WAY + 2 * BEAMS


class TrafficObserver:
    """Observes agents on a net; independent of runs."""

    def __init__(self, lane_map: LaneMap) -> None:
        self._road = LaneFeatures(lane_map)

    def observe(self, agents: PathFollowers) -> FloatArray:
        """Features (m, SIZE) of `agents`, with paths along their routes."""
        features = np.zeros((len(agents), SIZE))
        if not len(agents):
            return features
        table, rows = agents.table, agents.rows
        features[:, 0], features[:, 1] = table.length[rows] / LENGTH, table.width[rows] / WIDTH
        features[:, 2] = agents.speed / SPEED
        self._road.write(agents, OWN, features)
        here = agents.paths.project(np.arange(len(agents)), agents.x, agents.y).s
        unit_x, unit_y = directions_ahead(agents.paths, here, agents.reach)
        turn = np.arctan2(unit_y, unit_x)[:, 1:] - agents.yaw[:, None]
        features[:, OWN + ROAD : OWN + ROAD + WAY] = np.arctan2(np.sin(turn), np.cos(turn)) / HEADING
        distance, rate = _beams(table.arrays, rows, agents.own)
        features[:, OWN + ROAD + WAY : OWN + ROAD + WAY + BEAMS] = distance / BEAM
        features[:, OWN + ROAD + WAY + BEAMS :] = rate / RATE
        return np.minimum(np.maximum(features, -LIMIT, out=features), LIMIT, out=features)


@kernel
def _beams(agents: AgentArrays, rows: Ints, own_poses: PoseArrays) -> tuple[Floats2, Floats2]:
    """Beams of the agents in `rows` (m,) of all `agents`, from their `own_poses` (m,).

    Returns:
        distances (m, BEAMS) [m] from the box centres to the nearest boxes, BEAM for none; and their rates of change
        (m, BEAMS) [m/s], 0 for none.
    """
    distance, rate = np.full((len(rows), BEAMS), BEAM), np.zeros((len(rows), BEAMS))
    x, y, yaw, speed = agents.x, agents.y, agents.yaw, agents.speed
    own_x, own_y, own_yaw = own_poses
    begin, end = within_scenes(agents.scene, rows)
    for i in range(len(rows)):
        own = rows[i]
        rush_x, rush_y = speed[own] * math.cos(own_yaw[i]), speed[own] * math.sin(own_yaw[i])
        for j in range(begin[i], end[i]):
            dx, dy = own_x[i] - x[j], own_y[i] - y[j]
            half_length, half_width = 0.5 * agents.length[j], 0.5 * agents.width[j]
            if j == own or math.hypot(dx, dy) > BEAM + half_length + half_width:
                continue
            cos, sin = math.cos(yaw[j]), math.sin(yaw[j])
            along, left = dx * cos + dy * sin, dy * cos - dx * sin  # the observer in the frame of that agent
            for k in range(BEAMS):
                turn = own_yaw[i] - yaw[j] + 2.0 * math.pi * k / BEAMS
                ray_x, ray_y = math.cos(turn), math.sin(turn)
                enter, leave = 0.0, BEAM
                # the ray is within the box where it is between both pairs of opposite sides
                if abs(ray_x) > 1e-9:
                    first, second = (-half_length - along) / ray_x, (half_length - along) / ray_x
                    enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
                elif abs(along) > half_length:
                    leave = -1.0
                if abs(ray_y) > 1e-9:
                    first, second = (-half_width - left) / ray_y, (half_width - left) / ray_y
                    enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
                elif abs(left) > half_width:
                    leave = -1.0
                if enter <= leave and enter < distance[i, k]:
                    heading = own_yaw[i] + 2.0 * math.pi * k / BEAMS
                    towards_x, towards_y = math.cos(heading), math.sin(heading)
                    distance[i, k] = enter
                    rate[i, k] = (speed[j] * cos - rush_x) * towards_x + (speed[j] * sin - rush_y) * towards_y
    return distance, rate
