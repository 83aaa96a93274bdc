"""Sampled agents, which training puts under the policy without a conflict, and their tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from litsim_policy.driving.task import NOBODY, DrivingTask
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath
from litsim_research.policies.draw import Start, sampled_tasks
from litsim_research.policies.task import TaskConfig, all_nearest, recorded_task
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.batched import BatchedScenario


@dataclass(frozen=True)
class SampledTask:
    """Task of a sampled agent at one step; ids are those of the batched scenario.

    Attributes:
        agent: id.
        points: (k, 2) points of its path around its position [m].
        goal: x and y [m].
        due_step: see :class:`litsim_policy.driving.task.DrivingTask`.
        opponent: id of the agent that is nearest now, or NOBODY.
    """

    agent: int
    points: FloatArray
    goal: tuple[float, float]
    due_step: int
    opponent: int


@dataclass
class _SampledAgent:
    """A sampled agent: scene, id in it, whole path and current task, which is kept up to the step `passed`."""

    scene: int
    own: int
    path: ReferencePath
    goal: tuple[float, float]
    due_step: int
    has_opponent: bool
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
        self._agents = [batch.agent(one.scene, one.own) for one in self._sampled]
        self._paths = PathBatch.of([one.path.points for one in self._sampled])

    def of(self, table: AgentTable, *, to_log_end: bool) -> list[SampledTask]:
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
        at, s = rows[here], np.zeros(len(rows))
        s[here] = self._paths.project(here, table.x[at], table.y[at]).s
        begin, end = (ends[here].tolist() for ends in self._paths.window(s))
        opponents = all_nearest(table, at).tolist()
        found = []
        for k, opponent, i, j in zip(here.tolist(), opponents, begin, end, strict=True):
            one = self._sampled[k]
            if table.step > one.passed:
                self._renew(one, self._batch.table(one.scene, table))
            minded = opponent if one.has_opponent else NOBODY
            found.append(SampledTask(self._agents[k], one.path.points[i:j], one.goal, one.due_step, minded))
        return found

    def exchange(self, table: AgentTable, agents: IntArray) -> IntArray:
        """Draw another agent of its scene in place of each of the sampled `agents` (m,), at the step of `table`.

        Returns:
            the others (m,); NOBODY where no agent near the ego is left to draw, and the agent stays.
        """
        others = np.full(len(agents), NOBODY)
        for k, agent in enumerate(agents.tolist()):
            at = self._agents.index(agent)
            scene = self._sampled[at].scene
            start, taken = self._starts[scene], [one.own for one in self._sampled if one.scene == scene]
            own = self._batch.table(scene, table)
            config, random = self._config, start.random
            for task in sampled_tasks(own, start.scenario, 1, self._radius, config, random, but=taken):
                self._sampled[at] = self._begun(table.step, scene, task)
                self._agents[at] = others[k] = self._batch.agent(scene, task.agent)
        self._paths = PathBatch.of([one.path.points for one in self._sampled])
        return others

    def _begun(self, step: int, scene: int, task: DrivingTask) -> _SampledAgent:
        """Returns the sampled agent of a `task` that was drawn at `step`."""
        goal_x, goal_y = task.goal.tolist()
        passed = self._passed(step, task.due_step)
        has_opponent = task.opponent != NOBODY
        return _SampledAgent(scene, task.agent, task.path, (goal_x, goal_y), task.due_step, has_opponent, passed)

    def _past_log(self, table: AgentTable, rows: IntArray) -> BoolArray:
        """Returns whether the agents in `rows` (m,) of `table` are past their logs (m,)."""
        log = self._batch.log
        own = log.ids.searchsorted(table.id[rows])
        lags = log.lags(own, table.step, table.x[rows], table.y[rows])
        return np.asarray(table.step - lags >= log.last_step[own])

    def _renew(self, one: _SampledAgent, table: AgentTable) -> None:
        """Draw another task for `one`, in `table` of its scene."""
        start = self._starts[one.scene]
        task = recorded_task(start.scenario.log, one.path, table, table.row(one.own), self._renewed, start.random)
        goal_x, goal_y = task.goal.tolist()
        one.goal, one.due_step, one.has_opponent = (goal_x, goal_y), task.due_step, task.opponent != NOBODY
        one.passed = self._passed(table.step, task.due_step)

    def _passed(self, step: int, due_step: int) -> int:
        """Last step at which a task drawn at `step` is kept."""
        return max(step, due_step - min(self._config.goal_steps[0], 0))
