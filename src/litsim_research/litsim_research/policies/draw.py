"""Random draws of a training episode: scenario and ego, the ego's deviation from its log, and sampled agents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from litsim_policy.driving.task import DrivingTask
from litsim_policy.ego.ego import Ego
from litsim_policy.ego.idm import IdmEgo
from litsim_policy.ego.log import LogEgo
from litsim_policy.ego.perturbed import PerturbedConfig, PerturbedEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_policy.motion.reference_path import logged_path
from litsim_research.policies.task import TaskConfig, recorded_task
from litsim_sim.core.scene import AgentTable
from litsim_sim.scenario.scenario import Scenario

STAYS = 10  # an agent is sampled only if its log lasts for more steps than this


class Start(NamedTuple):
    """The start of an episode: scenario, ego, and the generator for all further draws."""

    scenario: Scenario
    ego: Ego
    random: np.random.Generator


def with_ego(scenario: Scenario, random: np.random.Generator) -> Scenario:
    """The scenario around a drawn one of its egos, with a drawn seed; recording, log and lane map are shared."""
    return scenario.around(int(random.choice(scenario.egos)), int(random.integers(2**31)))


def drawn_ego(scenario: Scenario, random: np.random.Generator, recorded: float = 0.0) -> Ego:
    """An ego that deviates from its log, IDM with drawn parameters or perturbed; one as recorded in a share of draws.

    The share is `recorded`, from 0 to 1.
    """
    if recorded > 0.0 and random.random() < recorded:
        return LogEgo(scenario)
    if random.random() < 0.5:
        row = scenario.log.row(scenario.ego_id)
        speed = float(scenario.log.speed[row][scenario.log.valid[row]].mean())
        idm = IdmConfig(
            desired_speed=max(3.0, speed * float(random.uniform(0.6, 1.3))),
            headway=float(random.uniform(0.6, 1.8)),
            standstill_gap=float(random.uniform(1.0, 3.0)),
            acceleration=float(random.uniform(0.8, 2.0)),
        )
        return IdmEgo(scenario, idm)
    perturbed = PerturbedConfig(
        time=(0.0, 8.0),
        deceleration=float(random.uniform(1.5, 6.0)),
        duration=float(random.uniform(0.5, 4.0)),
        lane_change_time=float(random.uniform(2.0, 5.0)),
    )
    return PerturbedEgo(scenario, perturbed)


def sampled_tasks(
    table: AgentTable,
    scenario: Scenario,
    count: int,
    radius: float,
    config: TaskConfig,
    random: np.random.Generator,
    but: Sequence[int] = (),
) -> list[DrivingTask]:
    """Tasks of up to `count` agents, drawn among those within `radius` [m] of the ego; ids ascending.

    Each agent follows its whole logged path, with a task drawn as for recorded drivers. Its log must last for more than
    another second; pedestrians and cyclists are never drawn, nor agents of `but`, nor anyone once the ego has left.
    """
    log, step = scenario.log, table.step
    ego = table.row(scenario.ego_id)
    rows = np.searchsorted(log.ids, table.id)
    near = np.hypot(table.x - table.x[ego], table.y - table.y[ego]) <= radius
    near &= (log.last_step[rows] > step + STAYS) & (table.id != scenario.ego_id) & ~table.obstacle
    near &= (ego >= 0) & ~np.isin(table.id, but)
    tasks = []
    for agent in sorted(random.permutation(table.id[near])[:count].tolist()):
        path = logged_path(log, scenario.lane_map, agent)
        tasks.append(recorded_task(log, path, table, table.row(agent), config, random))
    return tasks
