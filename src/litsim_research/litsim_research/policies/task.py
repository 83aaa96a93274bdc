"""Driving tasks, drawn alike for recorded drivers and for the agents that training puts under the policy.

A recording does not contain intentions. Each driver is therefore given a task that its own log roughly fulfils: a
position on the log as the goal, a time at which it is due there, and perhaps an opponent. Training compares recorded
drivers with the policy in such tasks, so both must draw them from the same distribution: if due times were exact, or
opponents always given, on one side only, the critic could tell the sides apart by the task alone.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import model_validator

from litsim_policy.driving.task import NOBODY, DrivingTask
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.quantities import Duration, NonNegative, Share, Steps, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, IntArray
from litsim_sim.kernels.compiled import Floats, Ints, kernel
from litsim_sim.scenario.log import Log


@configuration
class TaskConfig:
    """Distribution of the tasks.

    Attributes:
        goal_steps: lowest and highest number of steps from now to the logged position that becomes the goal; negative
            if the goal has been passed, as for agents that are held beyond their conflict.
        goal_jitter: standard deviation of the error in the due time; without it the goal would reveal the speed that
            was driven.
        opponent_share: share of tasks that name the nearest agent as the opponent; the others name none.
    """

    goal_steps: tuple[Steps, Steps] = (-20, 50)
    goal_jitter: NonNegative[Duration] = 1.0
    opponent_share: Share = 0.5

    @model_validator(mode="after")
    def _check(self) -> TaskConfig:
        low, high = self.goal_steps
        if low > high or high <= 0:
            raise ValueError(f"goal_steps is {self.goal_steps!r}, expected the lowest before the highest, above 0")
        return self


def recorded_task(
    log: Log, path: ReferencePath, table: AgentTable, row: int, config: TaskConfig, random: np.random.Generator
) -> DrivingTask:
    """Draw the task of the agent in `row` of `table`, which follows `path`; `table` and `log` share their ids."""
    agent = int(table.id[row])
    log_row = log.row(agent)
    ahead = int(random.integers(config.goal_steps[0], config.goal_steps[1] + 1))
    first = int(np.argmax(log.valid[log_row]))
    there = min(max(table.step + ahead, first), int(log.last_step[log_row]))
    late = round(float(random.normal(0.0, config.goal_jitter)) / STEP_S)
    opponent = nearest(table, row) if random.random() < config.opponent_share else NOBODY
    goal = np.array([log.x[log_row, there], log.y[log_row, there]])
    return DrivingTask(agent, path, goal, there + late, opponent)


def nearest(table: AgentTable, row: int) -> int:
    """Id of the agent in the same scene with its box centre nearest to that of the agent in `row`; NOBODY if alone."""
    return int(all_nearest(table, np.array([row]))[0])


def all_nearest(table: AgentTable, rows: IntArray) -> IntArray:
    """Ids (m,) that :func:`nearest` finds for the agents in `rows` (m,)."""
    least = _nearest(table.scene, table.x, table.y, rows)
    return np.where(least < 0, NOBODY, table.id[least])


@kernel
def _nearest(scene: Ints, x: Floats, y: Floats, rows: Ints) -> Ints:
    """Rows (m,) of the agents nearest to those in `rows` (m,), -1 for none; `scene`, `x` and `y` (n,) of all agents."""
    found, (begin, end) = np.full(len(rows), -1), within_scenes(scene, rows)
    for i in range(len(rows)):
        own, least = rows[i], np.inf
        for j in range(begin[i], end[i]):
            distance = math.hypot(x[j] - x[own], y[j] - y[own])
            if j != own and distance < least:
                found[i], least = j, distance
    return found
