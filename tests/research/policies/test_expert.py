"""Pairs of recorded drivers: what a displaced vehicle sees."""

from dataclasses import replace

import numpy as np

from litsim_policy.driving.features.observation import ObservationConfig, Observer
from litsim_policy.driving.task import DrivingTask
from litsim_policy.motion.reference_path import logged_path
from litsim_research.policies.expert import ExpertConfig, expert_pairs
from litsim_research.policies.task import TaskConfig
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.scenario import Scenario


def test_displaced_vehicles_see_together_what_each_would_see_alone() -> None:
    """To the last bit, whoever else is displaced, and each sees the others where they are."""
    scenario = Scenario.load("demo")
    log, observer = scenario.log, Observer(scenario.lane_map)
    table = log.table(60)
    rows = np.arange(0, len(table), 3)
    agents = table.id[rows].tolist()
    goal = np.array([table.x.mean(), table.y.mean()])
    paths = [logged_path(log, scenario.lane_map, agent) for agent in agents]
    tasks = [DrivingTask(agent, path, goal, 80) for agent, path in zip(agents, paths, strict=True)]
    random = np.random.default_rng(0)
    poses = tuple(getattr(table, f)[rows] + random.normal(0.0, 0.4, len(rows)) for f in ("x", "y", "yaw"))
    together = observer.observe(table, tasks, poses)
    assert len(together) > 10 and not np.array_equal(together, observer.observe(table, tasks))
    for k, (row, task) in enumerate(zip(rows.tolist(), tasks, strict=True)):
        columns = {f: getattr(table, f).copy() for f in ("x", "y", "yaw")}
        for name, values in zip(columns, poses, strict=True):
            columns[name][row] = values[k]
        assert np.array_equal(together[k], observer.observe(replace(table, **columns), [task])[0])


def test_driving_is_not_learned_from_who_rides_a_bicycle(make_scenario, track) -> None:
    """Two in a column, 15 m apart: both are seen to interact, and are learned from where they drive."""

    def pairs(kind: Kind) -> int:
        scenario = make_scenario(track(1, x=100.0), track(2, x=115.0, kind=kind))
        found = expert_pairs(
            [scenario], ObservationConfig(), ExpertConfig(beside=20.0), TaskConfig(), np.random.default_rng(0)
        )
        return len(found.observation)

    assert pairs(Kind.CAR) == 2 * pairs(Kind.BICYCLE) > 0
