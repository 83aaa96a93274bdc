"""Sampled agents, which training puts under the policy without a conflict, and their tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from litsim_policy.driving.task import NOBODY, DrivingTask
from litsim_policy.motion.path_batch import PathBatch
from litsim_research.policies.draw import Start, sampled_tasks
from litsim_research.policies.task import TaskConfig, all_nearest, recorded_task
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.batched import BatchedScenario


class Task(NamedTuple):
    """Task of a driven agent at one step, see :class:`litsim_policy.driving.task.DrivingTask`.

    Attributes:
        agent: id in the batched scenario.
        points: (k, 2) points of its path around its position [m].
        goal: x and y [m].
        due_step, opponent: as there; the opponent of a sampled agent is the one that is nearest now, or NOBODY.
        taken_over: whether the agent is off its log in a conflict; otherwise it is sampled.
    """

    agent: int
    points: FloatArray
    goal: tuple[float, float]
    due_step: int
    opponent: int
    taken_over: bool


@dataclass(frozen=True)
class _SampledAgent:
    """A sampled agent: its scene, and the current task by the ids of that scene, kept up to the step `passed`."""

    scene: int
    task: DrivingTask
    passed: int


class SampledAgents:
    """The sampled agents of E episodes, drawn when the episodes begin.

    Tasks are drawn as for recorded drivers (:func:`.task.recorded_task`). A task is replaced once its goal has been due
    for longer than that of any drawn task may be; the opponent is always the agent that is nearest now.
    """

    def __init__(
        self,
        batch: BatchedScenario,
        starts: Sequence[Start],
        table: AgentTable,
        count: int,
        radius: float,
        config: TaskConfig,
    ) -> None:
        self._batch, self._starts, self._config, self._radius = batch, starts, config, radius
        # a new goal is as far away as goals can be, which keeps the distances to goals uniformly distributed
        self._renewed = replace(config, goal_steps=(config.goal_steps[1], config.goal_steps[1]))
        self._sampled = [
            self._begun(table.step, k, task)
            for k, (start, own) in enumerate(zip(starts, batch.tables(table), strict=True))
            for task in sampled_tasks(own, start.scenario, count, radius, config, start.random)
        ]
        self._agents = [batch.agent(sampled.scene, sampled.task.agent) for sampled in self._sampled]
        self._paths = PathBatch.of([sampled.task.path.points for sampled in self._sampled])

    def of(self, table: AgentTable, *, to_log_end: bool) -> list[Task]:
        """Current tasks of the sampled agents that are on the road in `table`; `to_log_end`: and not past their logs.

        An agent is past its log if it is nearest to the last pose.
        """
        rows = table.rows(np.array(self._agents, np.int64))
        on_way = rows >= 0
        if to_log_end:
            on_way[on_way] = ~self._past_log(table, rows[on_way])
        here = np.flatnonzero(on_way)
        if not len(here):
            return []
        present, s = rows[here], np.zeros(len(rows))
        s[here] = self._paths.project(here, table.x[present], table.y[present]).s
        begin, end = (ends[here].tolist() for ends in self._paths.window(s))
        opponents = all_nearest(table, present).tolist()
        found = []
        for k, opponent, i, j in zip(here.tolist(), opponents, begin, end, strict=True):
            if table.step > self._sampled[k].passed:
                self._sampled[k] = self._with_next_task(self._sampled[k], table)
            task = self._sampled[k].task
            goal_x, goal_y = task.goal.tolist()
            minded = opponent if task.opponent != NOBODY else NOBODY
            points = task.path.points[i:j]
            found.append(Task(self._agents[k], points, (goal_x, goal_y), task.due_step, minded, taken_over=False))
        return found

    def exchange(self, table: AgentTable, agents: IntArray) -> IntArray:
        """Draw another agent of its scene in place of each of the sampled `agents` (m,), at the step of `table`.

        Returns:
            the others (m,); NOBODY where no agent near the ego is left to draw, and the agent stays.
        """
        others = np.full(len(agents), NOBODY)
        for k, agent in enumerate(agents.tolist()):
            index = self._agents.index(agent)
            scene = self._sampled[index].scene
            start = self._starts[scene]
            taken = [sampled.task.agent for sampled in self._sampled if sampled.scene == scene]
            own = self._batch.table(scene, table)
            config, random = self._config, start.random
            for task in sampled_tasks(own, start.scenario, 1, self._radius, config, random, but=taken):
                self._sampled[index] = self._begun(table.step, scene, task)
                self._agents[index] = others[k] = self._batch.agent(scene, task.agent)
        self._paths = PathBatch.of([sampled.task.path.points for sampled in self._sampled])
        return others

    def _begun(self, step: int, scene: int, task: DrivingTask) -> _SampledAgent:
        """Returns the sampled agent of a `task` that was drawn at `step`."""
        return _SampledAgent(scene, task, max(step, task.due_step - min(self._config.goal_steps[0], 0)))

    def _past_log(self, table: AgentTable, rows: IntArray) -> BoolArray:
        """Returns whether the agents in `rows` (m,) of `table` are past their logs (m,)."""
        log = self._batch.log
        own = log.ids.searchsorted(table.id[rows])
        lags = log.lags(own, table.step, table.x[rows], table.y[rows])
        return np.asarray(table.step - lags >= log.last_step[own])

    def _with_next_task(self, sampled: _SampledAgent, table: AgentTable) -> _SampledAgent:
        """Returns the `sampled` agent with another task, drawn at the step of `table`."""
        start, own = self._starts[sampled.scene], self._batch.table(sampled.scene, table)
        row, path = own.row(sampled.task.agent), sampled.task.path
        task = recorded_task(start.scenario.log, path, own, row, self._renewed, start.random)
        return self._begun(own.step, sampled.scene, task)
