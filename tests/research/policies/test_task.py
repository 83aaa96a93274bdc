"""Tasks of recorded drivers and of sampled agents: the same draw, so that nobody is known by his task."""

from typing import Any

import numpy as np
import pytest

from litsim_policy.driving.task import NOBODY
from litsim_policy.ego.log import LogEgo
from litsim_policy.motion.reference_path import logged_path
from litsim_research.policies.draw import Start
from litsim_research.policies.sampled_agents import SampledAgents
from litsim_research.policies.task import TaskConfig, all_nearest, nearest, recorded_task
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.scenario import Scenario


@pytest.fixture(scope="module")
def scenario(make_scenario: Any, track: Any) -> Scenario:
    """The ego at 100 m, 2 behind it, 3 far ahead."""
    return make_scenario(track(1, x=100.0, last=140), track(2, x=80.0, last=140), track(3, x=160.0, last=140))


def drawn(scenario: Scenario, config: TaskConfig, step: int, count: int) -> list[Any]:
    table, random = scenario.log.table(step), np.random.default_rng(0)
    path = logged_path(scenario.log, scenario.lane_map, 2)
    return [recorded_task(scenario.log, path, table, table.row(2), config, random) for _ in range(count)]


def test_a_task_is_a_place_on_the_log_and_a_time_that_is_somewhat_off(scenario: Scenario) -> None:
    log, row = scenario.log, scenario.log.row(2)
    tasks = drawn(scenario, TaskConfig(), 60, 600)
    at = np.array([int(np.argmin(np.abs(log.x[row] - task.goal[0]))) for task in tasks])
    assert at.min() == 40 and at.max() == 110
    late = np.array([task.due_step for task in tasks]) - at
    assert abs(late.mean()) < 1.5 and late.std() == pytest.approx(10.0, abs=1.5)
    assert {task.opponent for task in tasks} == {1, NOBODY}
    assert np.mean([task.opponent == 1 for task in tasks]) == pytest.approx(0.5, abs=0.07)
    exact = drawn(scenario, TaskConfig(goal_jitter=0.0, opponent_share=0.0), 60, 20)
    assert all(task.opponent == NOBODY and task.goal[0] == log.x[row, task.due_step] for task in exact)


def test_goals_lie_on_the_log_also_where_it_begins_and_ends(scenario: Scenario) -> None:
    assert {task.due_step for task in drawn(scenario, TaskConfig(goal_steps=(-20, 1), goal_jitter=0.0), 5, 99)} == set(
        range(7)
    )
    ends = drawn(scenario, TaskConfig(goal_steps=(50, 50), goal_jitter=0.0), 139, 3)
    assert [task.due_step for task in ends] == [140] * 3


def test_the_nearest_is_of_the_same_scene(agent_table: Any) -> None:
    table = agent_table(0, {"id": 1, "x": 0.0}, {"id": 2, "x": 9.0}, {"id": 3, "x": 5.0})
    assert [nearest(table, row) for row in range(3)] == [3, 3, 2]
    assert nearest(agent_table(0, {"id": 1, "x": 0.0}), 0) == NOBODY
    table.scene = np.array([0, 0, 1])
    assert all_nearest(table, np.arange(3)).tolist() == [2, 1, NOBODY]


@pytest.mark.parametrize("goal_steps", [(5, 4), (-20, 0)])
def test_goals_that_are_never_ahead(goal_steps: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="goal_steps"):
        TaskConfig(goal_steps=goal_steps)


def test_who_has_long_passed_his_goal_gets_the_next_one(scenario: Scenario) -> None:
    config = TaskConfig(goal_steps=(-5, 30), goal_jitter=0.0, opponent_share=1.0)
    batch = BatchedScenario.of([scenario])
    start = Start(scenario, LogEgo(scenario), np.random.default_rng(0))
    first = scenario.history_steps
    sampled = SampledAgents(batch, [start], batch.log.table(first), 5, 30.0, config)
    (agent,) = {task.agent for task in sampled.of(batch.log.table(first), to_log_end=False)}
    ahead = []
    for step in range(first, 100):
        table = batch.log.table(step)
        (task,) = sampled.of(table, to_log_end=False)
        ahead.append(task.due_step - step)
        row = batch.log.row(agent)
        assert task.goal == (batch.log.x[row, task.due_step], batch.log.y[row, task.due_step])
        assert task.opponent == nearest(table, table.row(agent)) != NOBODY
    assert set(ahead) == set(range(-5, 31)), "as far as they are drawn, both ways"
