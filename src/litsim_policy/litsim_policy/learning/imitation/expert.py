"""What recorded drivers did, as the baselines `gail` and `rail` see and do it."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import torch

from litsim_policy.driving.imitation_policy import BOUNDS
from litsim_policy.driving.traffic_observation import SIZE, TrafficObserver
from litsim_policy.learning.expert import inverse_dynamics, share_weights
from litsim_policy.learning.ppo import Demonstrations, tensor
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath, route_path
from litsim_sim.core.quantities import Positive, Share, Steps, configuration
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.scenario import Scenario


@configuration
class DriversConfig:
    """Which pairs are taken.

    Attributes:
        every: steps between the pairs of a vehicle.
        smooth: steps over which motion is averaged: recorded accelerations jitter from frame to frame.
        real_share: of the pairs that are shown, those of people, where there are any; the others are of SUMO's drivers.
    """

    every: Positive[Steps] = 5
    smooth: Positive[Steps] = 3
    real_share: Share = 0.5


def traffic_pairs(scenarios: Sequence[Scenario], config: DriversConfig, real: Collection[str] = ()) -> Demonstrations:
    """Observations (n, SIZE) and actions (n, 2) in [-1, 1] of all vehicles of `scenarios`.

    Routes are those of the logs, as a takeover would find them when a vehicle is first seen. In the scenarios named in
    `real` people drove.
    """
    found = [_of_scenario(scenario, config) for scenario in scenarios]
    people = np.concatenate([np.full(len(s), each.name in real) for each, (s, _) in zip(scenarios, found, strict=True)])
    observation, action = (np.concatenate([pair[side] for pair in found]) for side in (0, 1))
    weight = torch.as_tensor(share_weights(people, config.real_share))
    return Demonstrations(tensor(observation), tensor(action), weight)


def _of_scenario(scenario: Scenario, config: DriversConfig) -> tuple[FloatArray, FloatArray]:
    log, observer = scenario.log, TrafficObserver(scenario.lane_map)
    paths: dict[int, ReferencePath] = {}
    seen, done = [np.empty((0, SIZE))], [np.empty((0, len(BOUNDS)))]
    for step in range(0, log.steps - config.smooth, config.every):
        table = log.table(step)
        rows = np.searchsorted(log.ids, table.id)
        chosen = np.flatnonzero((log.last_step[rows] - step >= config.smooth) & ~table.obstacle)
        for row in chosen.tolist():
            agent = int(table.id[row])
            if agent not in paths:
                pose = np.array([table.x[row], table.y[row], table.yaw[row]])
                paths[agent] = route_path(log, scenario.lane_map, agent, pose)
        if not len(chosen):
            continue
        batch = PathBatch([paths[agent].points for agent in table.id[chosen].tolist()])
        seen.append(observer.observe(PathFollowers(scenario.lane_map, table, chosen, batch)))
        done.append(np.column_stack(inverse_dynamics(log, rows[chosen], step, config.smooth)) / BOUNDS)
    return np.concatenate(seen), np.clip(np.concatenate(done), -1.0, 1.0)
