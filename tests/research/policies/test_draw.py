"""What an episode draws: egos that the scenario offers, and agents near the ego that stay for a while."""

import numpy as np
import pytest

from litsim_research.policies.draw import drawn_ego, sampled_tasks, with_ego
from litsim_research.policies.task import TaskConfig
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.scenario import Scenario


@pytest.fixture(scope="module")
def traffic(make_scenario, track) -> Scenario:
    """The ego at 100 m; 2 and 3 are near, 4 is far, and 5, near, is gone a second after the history."""
    near = track(1, x=100.0, last=80), track(2, x=80.0, last=80), track(3, x=120.0, last=30)
    return make_scenario(*near, track(4, x=400.0, last=80), track(5, x=60.0, last=13), egos=[1, 2])


def test_an_ego_of_the_scenario_is_drawn_with_a_seed_of_its_own(traffic) -> None:
    drawn = [with_ego(traffic, np.random.default_rng(seed)) for seed in range(8)]
    assert {each.ego_id for each in drawn} == {1, 2}
    assert len({each.seed for each in drawn}) == len(drawn)
    assert all(each.log is traffic.log for each in drawn) and traffic.ego_id == 1, "the original stays as it is"


def test_egos_deviate_in_more_than_one_way(traffic) -> None:
    kinds = {type(drawn_ego(traffic, np.random.default_rng(seed))).__name__ for seed in range(8)}
    assert kinds == {"IdmEgo", "PerturbedEgo"}


def test_agents_near_the_ego_that_stay_are_sampled_towards_where_their_log_goes(traffic) -> None:
    table = traffic.log.table(3)
    config = TaskConfig(goal_steps=(50, 50), goal_jitter=0.0)
    tasks = sampled_tasks(table, traffic, 5, 50.0, config, np.random.default_rng(0))
    assert [task.agent for task in tasks] == [2, 3]
    assert [task.due_step for task in tasks] == [53, 30], "in 5 s, or at the end of the log"
    for task in tasks:
        row = traffic.log.row(task.agent)
        assert task.goal.tolist() == [traffic.log.x[row, task.due_step], traffic.log.y[row, task.due_step]]
        s, d = task.path.project(task.goal[:1], task.goal[1:])
        assert s[0] > 0.0 and abs(d[0]) < 0.1
    assert len(sampled_tasks(table, traffic, 1, 50.0, config, np.random.default_rng(0))) == 1


def test_who_walks_or_rides_beside_the_ego_is_not_sampled(make_scenario, track) -> None:
    """Who near the ego is a car is sampled, in whatever company."""
    others = track(2, x=80.0, kind=Kind.PEDESTRIAN), track(3, x=120.0, kind=Kind.BICYCLE), track(4, x=60.0)
    traffic = make_scenario(track(1, x=100.0), *others)
    tasks = sampled_tasks(traffic.log.table(3), traffic, 5, 50.0, TaskConfig(), np.random.default_rng(0))
    assert [task.agent for task in tasks] == [4]
