"""The environment in which policy C is trained: the loop of the graph in this process, closed around deviating egos.

Gymnasium's interface, for several agents at once that share one policy: an observation and an action have a row for
each of `slots`, and ``info["agents"]`` says whose row it is. Dynamics, detection, life cycle of takeovers and features
are those that the graph runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from litsim_policy.conflict.detection import ConflictConfig
from litsim_policy.conflict.takeover import TakeoverConfig, TakeoverManager
from litsim_policy.driving.action import consistent, normalised
from litsim_policy.driving.observation import LIMIT, ObservationConfig, Observer
from litsim_policy.driving.policy_c import commanded, merged
from litsim_policy.driving.registry import make_policy
from litsim_policy.driving.safety import LIMITS_ONLY, SafetyConfig, SafetyLayer
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.learning.draw import drafted_tasks, drawn_ego, with_ego
from litsim_policy.learning.reward import Penalties, PenaltyConfig, penalties
from litsim_policy.motion.reference_path import window
from litsim_predictor.models import ModelName, make_predictor
from litsim_sim.core.quantities import Length, NonNegative, Positive, Steps, Whole, configuration
from litsim_sim.core.scene import AgentTable, BoolArray, ControlSource, ControlTable, FloatArray, IntArray
from litsim_sim.core.takeover import TakeoverState, TakeoverTable
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.world import World

Array = np.ndarray
NOBODY = -1


@configuration
class EnvironmentConfig:
    """How long an episode lasts, and who is driven in it.

    Attributes:
        steps_max: simulated steps of 0.1 s after the history, fewer where the scenario ends before: the default is the
            paper's, but segments of 28 s have 250.
        slots: agents under the policy at a time; further ones yield by rule.
        drafted: agents near the ego that are put under the policy at the start, conflict or not.
        draft_radius: around the ego within which they are drawn.
        draft_steps: for how long at most.
        model: predictor.
    """

    steps_max: Positive[Steps] = 300
    slots: Positive[Whole] = 10
    drafted: NonNegative[Whole] = 5
    draft_radius: NonNegative[Length] = 50.0
    draft_steps: NonNegative[Steps] = 100
    model: ModelName = "kinematic"


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step did to the agents that were driven; arrays (m, ...), in the order of the slots.

    Attributes:
        agents: ids.
        following: (m, size) observations after the step; of an agent that has left the road, the last one.
        executed: (m, 3) what the vehicle did, as actions in [-1, 1].
        penalty: (m,) weighted, at most 0.
        terms: what it is made of.
        terminated: (m,) in collision or off the road.
        driven_on: (m,) whether the agent is in a slot of the next step.
    """

    agents: IntArray
    following: FloatArray
    executed: FloatArray
    penalty: FloatArray
    terms: Penalties
    terminated: BoolArray
    driven_on: BoolArray

    def __eq__(self, other: object) -> bool:
        """Whether all arrays are equal."""
        if not isinstance(other, Outcome):
            return NotImplemented
        mine, theirs = (list(vars(o).values()) + list(vars(o.terms).values()) for o in (self, other))
        return all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True) if not isinstance(a, Penalties))

    __hash__ = None  # type: ignore[assignment]


class PolicyEnvironment(gymnasium.Env[Array, Array]):
    """Episodes on `scenarios`, with an ego, its deviation and drafted agents drawn by the seed.

    An episode is terminated when a driven agent collides or leaves the road, and truncated when its time is up. Steps
    at which nobody is driven pass by themselves.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as the base class has it

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        config: EnvironmentConfig | None = None,
        observation: ObservationConfig | None = None,
        penalty: PenaltyConfig | None = None,
        safety: SafetyConfig = LIMITS_ONLY,
    ) -> None:
        self.config = config or EnvironmentConfig()
        self._scenarios = list(scenarios)
        self._observation = observation or ObservationConfig()
        self._penalty = penalty or PenaltyConfig()
        self._safety_config = safety
        slots, size = self.config.slots, self._observation.size
        self.observation_space = gymnasium.spaces.Box(-LIMIT, LIMIT, (slots, size), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (slots, 3), np.float64)
        self.scenario: Scenario
        self.world: World

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """A new episode, up to the first step at which somebody is driven; `options` are not used."""
        super().reset(seed=seed, options=options)
        random = self.np_random
        self.scenario = with_ego(self._scenarios[int(random.integers(len(self._scenarios)))], random)
        self.world = World(self.scenario)
        self.safety = SafetyLayer(self.scenario.lane_map, self._safety_config)
        self._guards = SafetyLayer(self.scenario.lane_map)  # they only tell
        self._observer = Observer(self.scenario.lane_map, self._observation)
        self._ego = drawn_ego(self.scenario, random)
        self._predictor = make_predictor(self.config.model, self.scenario)
        self._manager = TakeoverManager(self.scenario, ConflictConfig(), TakeoverConfig())
        self._rule = make_policy("yield", self.scenario)
        self._end = min(self.scenario.total_steps, self.scenario.history_steps + self.config.steps_max)
        self._drafted: list[DrivingTask] = []
        table = self.world.reset()
        while table.step < self.scenario.history_steps:
            self._predictor.see(table)
            table = self.world.step(ControlTable.empty(table.step), self._ego.plan(table))
        self._see(table)
        self._drafted = drafted_tasks(self._table, self.scenario, self.config.drafted, self.config.draft_radius, random)
        self._choose()
        self._pass_by()
        self._seen = self._observer.features(self._scene)
        return self._observations(), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive the agents in the slots by `action` (slots, 3) in [-1, 1].

        Returns:
            observation (slots, size), mean penalty of the driven agents, terminated, truncated, and info: `agents`
            (slots,), -1 where a slot is empty, and `outcome`.
        """
        before, tasks, scene = self._table, self._tasks, self._scene
        driven = np.array([task.agent for task in tasks], np.int64)
        wanted = np.asarray(action, np.float64)[: len(tasks)]
        guarded = commanded(scene, wanted, self._guards).source == ControlSource.GUARDED
        controls = commanded(scene, wanted, self.safety)
        self._advance(merged(controls, self._others_controls()))
        self._choose()
        outcome = self._outcome(before, driven, tasks, guarded)
        terminated = bool(outcome.terminated.any())
        if not self._tasks and not terminated:
            self._pass_by()
            self._seen = self._observer.features(self._scene)
        reward = float(outcome.penalty.mean()) if len(driven) else 0.0
        truncated = not terminated and self._table.step >= self._end
        return self._observations(), reward, terminated, truncated, self._info() | {"outcome": outcome}

    def _see(self, table: AgentTable) -> None:
        """Make `table` the current step: forecast it and see who is off the log; nobody is in a slot yet."""
        self._table = table
        self._takeovers = self._manager.update(table, self._predictor.forecast(table))
        self._tasks: list[DrivingTask] = []

    def _advance(self, controls: ControlTable) -> None:
        self._see(self.world.step(controls, self._ego.plan(self._table)))

    def _choose(self) -> None:
        """Fill the slots for the current step, ids ascending, with who is held and who is drafted."""
        table = self._table
        if table.step >= self.scenario.history_steps + self.config.draft_steps:
            self._drafted = []
        tasks = {t.agent: DrivingTask.of(t) for t in self._takeovers.takeovers if t.state == TakeoverState.HELD}
        for task in self._drafted:
            row = table.row(task.agent)
            if row >= 0:
                part = window(task.path, float(table.x[row]), float(table.y[row]))
                held = tasks.get(task.agent, task)
                tasks[task.agent] = DrivingTask(task.agent, part, task.goal, task.due_step, held.opponent)
        self._tasks = [tasks[agent] for agent in sorted(tasks)][: self.config.slots]
        self._scene = self._with_tasks(self._tasks)

    def _pass_by(self) -> None:
        """Let steps pass until somebody is in a slot or the episode's time is up."""
        while not self._tasks and self._table.step < self._end:
            self._advance(self._others_controls())
            self._choose()

    def _others_controls(self) -> ControlTable:
        """The rules' answer to the current step, for the agents that are off their log and in no slot."""
        driven = {task.agent for task in self._tasks}
        others = tuple(t for t in self._takeovers.takeovers if t.agent not in driven)
        return self._rule.act(self._table, TakeoverTable(self._table.step, others))

    def _outcome(self, before: AgentTable, driven: IntArray, tasks: list[DrivingTask], guarded: BoolArray) -> Outcome:
        """What the step from `before` to now did to the agents that were `driven`, some by commands to be `guarded`."""
        after = self._table
        rows = after.rows(driven)
        here = rows >= 0
        now = {task.agent: task for task in self._tasks}
        left = [e for e, is_here in zip(tasks, here.tolist(), strict=True) if is_here and e.agent not in now]
        seen = self._observer.features(self._with_tasks([*self._tasks, *left]) if left else self._scene)
        following = self._seen
        at = {task.agent: k for k, task in enumerate([*self._tasks, *left])}
        following[here] = seen[[at[agent] for agent in driven[here].tolist()]]
        self._seen = seen[: len(self._tasks)]
        executed = np.zeros((len(driven), 3))
        rows = rows[here]
        speed = 0.5 * (after.speed[rows] + before.speed[before.rows(driven[here])])
        executed[here] = normalised(consistent(after.acceleration[rows], after.yaw_rate[rows], speed))
        terms = penalties(before, after, driven[here], self.scenario.lane_map, guarded[here])
        penalty, terminated = np.zeros(len(driven)), np.zeros(len(driven), np.bool_)
        penalty[here], terminated[here] = terms.total(self._penalty), terms.collision | terms.off_road
        driven_on = here & np.isin(driven, list(now)) & (after.step < self._end) & ~terminated.any()
        return Outcome(driven, following, executed, penalty, terms, terminated, driven_on)

    def _with_tasks(self, tasks: list[DrivingTask]) -> DrivingScene:
        """The agents with `tasks` now."""
        return DrivingScene.of(self.scenario.lane_map, self._table, tasks)

    def _observations(self) -> Array:
        """Observations (slots, size) of who is in the slots now; zeros where a slot is empty."""
        observation = np.zeros(self.observation_space.shape or ())
        observation[: len(self._tasks)] = self._seen
        return observation

    def _info(self) -> dict[str, Any]:
        agents = np.full(self.config.slots, NOBODY, np.int64)
        agents[: len(self._tasks)] = [task.agent for task in self._tasks]
        return {"agents": agents, "step": self._table.step, "scenario": self.scenario.name}
