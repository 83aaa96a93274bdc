"""Expert pairs for the baselines `gail` and `rail`: their observations and actions, from recorded drivers."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from litsim_policy.driving.features.traffic_observation import SIZE, TrafficObserver
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath, logged_path, route_path, window
from litsim_research.baselines.imitation_policy import BOUNDS
from litsim_research.policies.expert import PairsConfig, displaced, inverse_dynamics, share_weights
from litsim_research.policies.ppo import Demonstrations, tensor
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class TrafficPairs:
    """Observations (n, SIZE) and actions (n, 2) in [-1, 1], twice.

    Attributes:
        recorded: of the drivers.
        corrected: of the same moments with the vehicle displaced, and the actions that lead back to its path.
    """

    recorded: Demonstrations
    corrected: Demonstrations

    @property
    def shown(self) -> Demonstrations:
        """Both, with equal weight."""
        sides = self.recorded, self.corrected
        weights = [side.weight for side in sides if side.weight is not None]
        return Demonstrations(
            torch.cat([side.observation for side in sides]),
            torch.cat([side.action for side in sides]),
            torch.cat(weights),
        )


def traffic_pairs(
    scenarios: Sequence[Scenario], config: PairsConfig, random: np.random.Generator, real: Collection[str] = ()
) -> TrafficPairs:
    """Returns pairs of all vehicles of `scenarios`.

    Paths follow the logs' routes, as after a takeover at the vehicle's first pair. `real` names the scenarios in which
    people drove.
    """
    pairs = [_of_scenario(scenario, config, random) for scenario in scenarios]
    people = np.repeat([scenario.name in real for scenario in scenarios], [len(columns[0]) for columns in pairs])
    tensors = [tensor(np.concatenate(column)) for column in zip(*pairs, strict=True)]
    weight = torch.as_tensor(share_weights(people, config.real_share))
    return TrafficPairs(Demonstrations(tensors[0], tensors[1], weight), Demonstrations(tensors[2], tensors[3], weight))


def _of_scenario(scenario: Scenario, config: PairsConfig, random: np.random.Generator) -> tuple[FloatArray, ...]:
    """Returns observations (n, SIZE) and actions (n, 2) as recorded, then those of displaced vehicles."""
    log, observer = scenario.log, TrafficObserver(scenario.lane_map)
    routes: dict[int, ReferencePath] = {}
    logged: dict[int, ReferencePath] = {}
    nothing = np.empty((0, SIZE)), np.empty((0, len(BOUNDS)))
    steps: list[tuple[FloatArray, ...]] = [(*nothing, *nothing)]
    for step in range(0, log.steps - config.smooth, config.every):
        table = log.table(step)
        rows = np.searchsorted(log.ids, table.id)
        chosen = np.flatnonzero((log.last_step[rows] - step >= config.smooth) & ~table.obstacle)
        if not len(chosen):
            continue
        agents = table.id[chosen].tolist()
        for agent, row in zip(agents, chosen.tolist(), strict=True):
            if agent not in routes:
                pose = np.array([table.x[row], table.y[row], table.yaw[row]])
                routes[agent] = route_path(log, scenario.lane_map, agent, pose)
                logged[agent] = logged_path(log, scenario.lane_map, agent)
        batch = PathBatch.of([routes[agent].points for agent in agents])
        ways = [
            window(logged[agent], float(table.x[row]), float(table.y[row]))
            for agent, row in zip(agents, chosen.tolist(), strict=True)
        ]
        poses, steering = displaced(table, chosen, ways, config.offset, config.turn, random)
        acceleration, yaw_rate = inverse_dynamics(log, rows[chosen], step, config.smooth)
        observed = observer.observe(PathFollowers(scenario.lane_map, table, chosen, batch))
        displaced_observed = observer.observe(PathFollowers(scenario.lane_map, table, chosen, batch, poses))
        actions, corrections = (
            np.clip(np.column_stack([acceleration, turn]) / BOUNDS, -1.0, 1.0) for turn in (yaw_rate, steering)
        )
        steps.append((observed, actions, displaced_observed, corrections))
    return tuple(np.concatenate(column) for column in zip(*steps, strict=True))
