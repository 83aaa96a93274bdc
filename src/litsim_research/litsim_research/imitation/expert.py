"""Expert pairs for the baselines `gail` and `rail`: their observations and actions, from recorded drivers."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from litsim_policy.driving.features.traffic_observation import TrafficObserver
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath, logged_path, route_path, window
from litsim_research.baselines.imitation_policy import Turning, largest
from litsim_research.policies.expert import ExpertPairs, PairsConfig, displaced, inverse_dynamics, moments
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.scenario import Scenario


def traffic_pairs(
    scenarios: Sequence[Scenario],
    config: PairsConfig,
    random: np.random.Generator,
    real: Collection[str] = (),
    turning: Turning = "published",
) -> ExpertPairs:
    """Returns pairs of all vehicles of `scenarios`: observations (n, SIZE) and actions (n, 2).

    Paths follow the logs' routes, as after a takeover at the vehicle's first pair. `real` names the scenarios in which
    people drove; `turning` says what yaw rate action 1 is.
    """
    people = [scenario.name in real for scenario in scenarios]
    return ExpertPairs.of(scenarios, lambda scenario: _of_scenario(scenario, config, random, turning), people)


def _of_scenario(
    scenario: Scenario, config: PairsConfig, random: np.random.Generator, turning: Turning
) -> Iterator[tuple[FloatArray, ...]]:
    """Yields the first four columns of :class:`.ExpertPairs` for steps of one scenario."""
    log, observer = scenario.log, TrafficObserver(scenario.lane_map)
    routes: dict[int, ReferencePath] = {}
    logged: dict[int, ReferencePath] = {}
    for table, rows, stays in moments(log, config):
        chosen = np.flatnonzero(stays & ~table.obstacle)
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
        acceleration, yaw_rate = inverse_dynamics(log, rows[chosen], table.step, config.smooth)
        observed = observer.observe(PathFollowers(scenario.lane_map, table, chosen, batch))
        displaced_observed = observer.observe(PathFollowers(scenario.lane_map, table, chosen, batch, poses))
        actions, corrections = (
            np.clip(np.column_stack([acceleration, turn]) / largest(table.speed[chosen], turning), -1.0, 1.0)
            for turn in (yaw_rate, steering)
        )
        yield observed, actions, displaced_observed, corrections
