"""Training episodes: the closed loop of the graph in one process, around deviating egos, several episodes at once.

Dynamics, conflict detection, the life cycle of takeovers and features are those of the graph. Episodes on scenarios of
one kind are stepped together, without influence on each other: see :mod:`litsim_sim.scenario.batched`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.utils import seeding

from litsim_policy.driving.action import consistent, normalised
from litsim_policy.driving.features.observation import ObservationConfig, Observer
from litsim_policy.driving.policy_c import executed, guarded
from litsim_policy.driving.safety.layer import SafetyConfig, SafetyLayer
from litsim_policy.driving.task import NOBODY, DrivingScene, due_step, opponent_of
from litsim_research.policies.draw import Start, drawn_ego, with_ego
from litsim_research.policies.reward import Penalties, PenaltyConfig, displacement, passed_on, penalties
from litsim_research.policies.sampled_agents import SampledAgents, Task
from litsim_research.policies.task import TaskConfig
from litsim_sim.core.quantities import Flag, Length, NonNegative, Positive, Share, Steps, Whole, configuration
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.stages import PREDICTOR
from litsim_sim.core.takeover import PathSource, Takeover
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation


@configuration
class EnvironmentConfig:
    """Length of an episode, and the agents driven in it.

    Attributes:
        steps_max: steps after the history, fewer where the scenario ends before; the default is the paper's, while
            segments of 28 s have 250.
        slots: most agents under the policy at a time; further ones are driven by policy yield.
        sampled: agents near the ego that are put under the policy at the start, with or without a conflict.
        sample_radius: distance from the ego within which they are drawn.
        sample_steps: steps after the history for which they stay under the policy.
        handback_ends: whether no penalties are expected of agents that have been handed back, have left the scene, or
            have come to where their logs end, where sampled ones are no longer driven.
        off_road_ends: whether an episode is over once a driven agent has left the road.
        recorded: share of episodes in which the ego drives as recorded. There, the states that the policy visits are
            comparable to drivers', so that the critic learns from these episodes only, if there are any.
    """

    steps_max: Positive[Steps] = 300
    slots: Positive[Whole] = 10
    sampled: NonNegative[Whole] = 5
    sample_radius: NonNegative[Length] = 50.0
    sample_steps: NonNegative[Steps] = 100
    handback_ends: Flag = False
    off_road_ends: Flag = True
    recorded: Share = 0.0


@dataclass(frozen=True)
class Course:
    """Settings that all episodes have in common.

    Attributes:
        scenarios: each episode draws one of them.
        config: of episodes.
        observation: of the driven agents.
        penalty: weights of the penalties.
        safety: limits and guard on the policy's actions; need of the guard is penalised instead.
        task: distribution of the sampled agents' tasks.
    """

    scenarios: Sequence[Scenario]
    config: EnvironmentConfig = EnvironmentConfig()
    observation: ObservationConfig = ObservationConfig()
    penalty: PenaltyConfig = PenaltyConfig()
    safety: SafetyConfig = SafetyConfig(contact=False)
    task: TaskConfig = TaskConfig()

    def scenario(self, random: np.random.Generator) -> Scenario:
        """Draw one of the scenarios; the first draw of an episode."""
        return self.scenarios[int(random.integers(len(self.scenarios)))]

    def scenario_of(self, seed: int) -> Scenario:
        """Returns the scenario that the episode of `seed` will draw."""
        return self.scenario(seeding.np_random(seed)[0])

    def start(self, random: np.random.Generator) -> Start:
        """Draw the start of an episode: scenario and ego, and `random` itself for the further draws."""
        scenario = with_ego(self.scenario(random), random)
        return Start(scenario, drawn_ego(scenario, random, self.config.recorded), random)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a step for the m agents driven in it; arrays (m, ...), ids ascending.

    Attributes:
        agents: ids.
        following: (m, size) observations after the step; of an agent that has left the scene, the one before.
        executed: (m, 3) executed motion, as actions in [-1, 1].
        penalty: (m,) weighted sum, at most 0.
        terms: the penalties before weights, of the agents in `present`.
        present: ids of the agents that are still in the scene.
        terminated: (m,) whether no penalties can follow: the agent has collided, or, with `off_road_ends`, left the
            road, or, with `handback_ends`, is handed back or at the end of its log.
        driven_on: (m,) whether the agent is driven in the next step.
    """

    agents: IntArray
    following: FloatArray
    executed: FloatArray
    penalty: FloatArray
    terms: Penalties
    present: IntArray
    terminated: BoolArray
    driven_on: BoolArray

    def __eq__(self, other: object) -> bool:
        """Whether all arrays are equal; NaN equals NaN."""
        if not isinstance(other, Outcome):
            return NotImplemented
        mine, theirs = (list(vars(o).values()) + list(vars(o.terms).values()) for o in (self, other))
        return all(_same(a, b) for a, b in zip(mine, theirs, strict=True) if not isinstance(a, Penalties))

    __hash__ = None  # type: ignore[assignment]


class Episodes:
    """E episodes on scenarios of one :func:`litsim_sim.scenario.batched.kind`, from the first step after the history.

    An episode is over when a driven agent collides, or, with `off_road_ends`, leaves the road, or when its time is up.
    Ids of agents are those of the batched scenario.

    Args:
        course: settings.
        starts: of each episode.
        sampled_only: whether only sampled agents are driven, also while they are taken over.
        failure_ends: whether an episode is over once a driven agent collides or leaves the road; else it goes on, and
            the caller has that agent exchanged (:meth:`exchange`).

    Attributes:
        batch: the scenarios.
        egos: of each episode.
        seen: (m, size) observations of the :attr:`driven` agents.
    """

    def __init__(
        self, course: Course, starts: Sequence[Start], *, sampled_only: bool = False, failure_ends: bool = True
    ) -> None:
        self._course, self._config = course, course.config
        self._sampled_only, self._failure_ends = sampled_only, failure_ends
        scenarios, self.egos = [start.scenario for start in starts], [start.ego for start in starts]
        self._simulation = Simulation(
            scenarios, self.egos, "yield", {PREDICTOR: {"model": "kinematic"}}, full_length=True
        )
        assert self._simulation.batch is not None
        self.batch = self._simulation.batch
        self.safety = SafetyLayer(course.safety)
        self._guard = SafetyLayer()  # for the penalty only
        self._observer = Observer(self.batch.lane_map, course.observation)
        totals = np.array([scenario.total_steps for scenario in scenarios])
        self._end = np.minimum(totals, self.batch.history_steps + self._config.steps_max)
        while self.step_number < self.batch.history_steps:  # everything follows its log, the ego as well
            self._simulation.step()
        sampled, radius = self._config.sampled, self._config.sample_radius
        self._sampled_agents = SampledAgents(self.batch, starts, self._table, sampled, radius, course.task)
        self._choose()
        self.seen = self._observer.features(self._scene)
        self._leave_out(self.step_number >= self._end)

    @property
    def step_number(self) -> int:
        """The current step, the same in all episodes."""
        return self._table.step

    @property
    def running(self) -> BoolArray:
        """(E,) whether each episode is not over."""
        running = np.zeros(len(self._end), np.bool_)
        running[list(self._simulation.running)] = True
        return running

    @property
    def driven(self) -> IntArray:
        """Ids (m,) of the agents that are driven in the next step, ascending."""
        return self._scene.id

    def step(self, action: FloatArray) -> Outcome:
        """Drive the :attr:`driven` agents by `action` (m, 3) in [-1, 1], others off their logs by policy yield."""
        before, tasks, scene = self._table, self._tasks, self._scene
        command = executed(scene, action)
        needed = self._guard.guard(scene, *command).guarded
        self._simulation.step(controls=guarded(scene, *command, self.safety))
        self._choose()
        outcome = self._outcome(before, scene.id, tasks, needed)
        over = self.step_number >= self._end
        if self._failure_ends:
            over[self.batch.log.scene[outcome.present[self._fails(outcome.terms)]]] = True
        self._leave_out(over)
        return outcome

    def exchange(self, agents: IntArray) -> IntArray:
        """Drive others instead of sampled `agents` (m,) from now on; returns those (m,), NOBODY where none is left."""
        others = self._sampled_agents.exchange(self._table, agents)
        self._choose()
        self.seen = self._observer.features(self._scene)
        return others

    @property
    def _table(self) -> AgentTable:
        """All agents at the current step."""
        return self._simulation.table

    @property
    def _takeovers(self) -> tuple[Takeover, ...]:
        """The agents off their logs at the current step."""
        assert self._simulation.takeovers is not None
        return self._simulation.takeovers.takeovers

    def _choose(self) -> None:
        """Choose the agents driven at the current step: held and sampled ones, up to `slots` in each episode."""
        tasks = {
            t.agent: Task(t.agent, t.reference_path, t.goal_pose[:2], due_step(t), opponent_of(t), taken_over=True)
            for t in self._takeovers
            if t.state.drives_on and t.path_source != PathSource.LANE  # passing agents are driven by rules
        }
        sampling = self.step_number < self.batch.history_steps + self._config.sample_steps
        sampled = self._sampled_agents.of(self._table, to_log_end=self._config.handback_ends) if sampling else []
        for task in sampled:
            held = tasks.get(task.agent)
            tasks[task.agent] = task if held is None else task._replace(opponent=held.opponent, taken_over=True)
        if self._sampled_only:
            tasks = {task.agent: tasks[task.agent] for task in sampled}
        counts = np.zeros(len(self.running), np.int64)
        self._tasks = []
        for agent in sorted(tasks):
            scene = self.batch.log.scene[agent]
            counts[scene] += 1
            if counts[scene] <= self._config.slots:
                self._tasks.append(tasks[agent])
        self._scene = self._with_tasks(self._tasks)

    def _outcome(self, before: AgentTable, driven: IntArray, tasks: list[Task], needed: BoolArray) -> Outcome:
        """The outcome of the step from `before` to now.

        Args:
            before: all agents before the step.
            driven: (m,) ids of the agents that were driven.
            tasks: of these.
            needed: (m,) whether the guard would have changed the command.
        """
        after = self._table
        rows = after.rows(driven)
        here = rows >= 0
        now = {task.agent for task in self._tasks}
        left = [task for task, is_here in zip(tasks, here.tolist(), strict=True) if is_here and task.agent not in now]
        seen = self._observer.features(self._with_tasks([*self._tasks, *left]) if left else self._scene)
        following = self.seen
        place = {task.agent: k for k, task in enumerate([*self._tasks, *left])}
        following[here] = seen[[place[agent] for agent in driven[here].tolist()]]
        self.seen = seen[: len(self._tasks)]
        motion = np.zeros((len(driven), 3))
        rows = rows[here]
        speed = 0.5 * (after.speed[rows] + before.speed[before.rows(driven[here])])
        motion[here] = normalised(consistent(after.acceleration[rows], after.yaw_rate[rows], speed))
        strayed = displacement(before, after, driven[here], self.batch.log)
        terms = penalties(before, after, driven[here], self.batch.lane_map, needed[here], strayed)
        penalty, terminated = np.zeros(len(driven)), np.zeros(len(driven), np.bool_)
        penalty[here], terminated[here] = terms.total(self._course.penalty), self._fails(terms)
        because = np.array([task.opponent if task.taken_over else NOBODY for task in tasks], np.int64)
        penalty += self._course.penalty.share * passed_on(penalty, driven, because)
        scene, failed = self.batch.log.scene[driven], terminated.copy()
        if self._failure_ends:
            failed = np.isin(scene, scene[terminated])
        still = np.array([agent in now for agent in driven.tolist()], np.bool_)
        driven_on = here & still & (after.step < self._end[scene]) & ~failed
        if self._config.handback_ends:
            held = {t.agent for t in self._takeovers if t.state.drives_on}
            back = np.array([agent not in held for agent in driven.tolist()], np.bool_)
            terminated |= (back & ~still) | ~here
        return Outcome(driven, following, motion, penalty, terms, driven[here], terminated, driven_on)

    def _fails(self, terms: Penalties) -> BoolArray:
        """Returns whether the agents have failed in a step (m,)."""
        return terms.collision | terms.off_road if self._config.off_road_ends else terms.collision

    def _leave_out(self, over: BoolArray) -> None:
        """End the episodes in the mask `over` (E,) and remove their agents."""
        ending = np.flatnonzero(self.running & over).tolist()
        if not ending:
            return
        for scene in ending:
            self._simulation.end(scene)
        stays = self.running[self.batch.log.scene[self.driven]]
        self._tasks = [task for task, is_left in zip(self._tasks, stays.tolist(), strict=True) if is_left]
        self.seen = self.seen[stays]
        self._scene = self._with_tasks(self._tasks)

    def _with_tasks(self, tasks: Sequence[Task]) -> DrivingScene:
        """The current scene of the agents with `tasks`."""
        return DrivingScene.on_paths(
            self.batch.lane_map,
            self._table,
            [task.points for task in tasks],
            [task.goal for task in tasks],
            [(task.agent, task.due_step, task.opponent) for task in tasks],
        )


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two arrays are equal; NaN equals NaN."""
    return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
