"""Where a driver of a recording is said to be going: one draw for drivers who are watched and for agents who drive.

A recording tells no intentions. Each driver is therefore given a task that his own log fulfils, more or less: a place
on it, a time at which he is said to be due there, and perhaps an opponent. Training compares what recorded drivers do
with what the policy does in such tasks, so both have to get theirs here: if one side knew the times to the step and the
other did not, or one side always had an opponent, the sides could be told apart by that alone.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import model_validator

from litsim_policy.driving.task import NOBODY, DrivingTask
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.compiled import FLOATS, INTS, OUT_INTS, kernel
from litsim_sim.core.pair_geometry import within_scenes
from litsim_sim.core.quantities import Duration, NonNegative, Share, Steps, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray, IntArray
from litsim_sim.scenario.log import Log


@configuration
class TaskConfig:
    """What is drawn.

    Attributes:
        goal_steps: lowest and highest number of steps to the place that is taken for the goal; negative ones say that
            it has been passed, as it has for agents who are held beyond their conflict.
        goal_jitter: standard deviation of the time by which the goal is said to be due too early or too late; without
            it the goal would tell the speed that was driven.
        opponent_share: of the tasks that name the nearest agent as the opponent; the others name nobody.
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
    """Draw the task of the agent in `row` of `table`, who follows `path`; ids of `table` are those of `log`."""
    agent = int(table.id[row])
    at = log.row(agent)
    ahead = int(random.integers(config.goal_steps[0], config.goal_steps[1] + 1))
    first = int(np.argmax(log.valid[at]))
    there = min(max(table.step + ahead, first), int(log.last_step[at]))
    late = round(float(random.normal(0.0, config.goal_jitter)) / STEP_S)
    opponent = nearest(table, row) if random.random() < config.opponent_share else NOBODY
    goal = np.array([log.x[at, there], log.y[at, there]])
    return DrivingTask(agent, path, goal, there + late, opponent)


def nearest(table: AgentTable, row: int) -> int:
    """Id of the agent of the same scene whose box centre is nearest to that of the agent in `row`; NOBODY if alone."""
    return int(all_nearest(table, np.array([row]))[0])


def all_nearest(table: AgentTable, rows: IntArray) -> IntArray:
    """What :func:`nearest` finds, (m,) ids, for each of the agents in `rows` (m,)."""
    least = _nearest(table.scene, table.x, table.y, rows)
    return np.where(least < 0, NOBODY, table.id[least])


@kernel(OUT_INTS(INTS, FLOATS, FLOATS, INTS))
def _nearest(scene: IntArray, x: FloatArray, y: FloatArray, rows: IntArray) -> IntArray:
    """Rows (m,) of those nearest to the agents in `rows` (m,), below 0 for nobody; the others (n,) are of everybody."""
    found, (begin, end) = np.full(len(rows), -1), within_scenes(scene, rows)
    for i in range(len(rows)):
        own, least = rows[i], np.inf
        for j in range(begin[i], end[i]):
            distance = math.hypot(x[j] - x[own], y[j] - y[own])
            if j != own and distance < least:
                found[i], least = j, distance
    return found
